"""The camera conventions that the whole package relies on."""

import numpy as np
import pytest

from fourd.base.cameras import Camera, fading_weights, look_at, nearest_views, select_views

INTRINSICS = np.array([[100.0, 0, 32], [0, 110, 24], [0, 0, 1]])


def test_point_on_the_axis_projects_to_the_principal_point() -> None:
    """Catches a camera-to-world rotation that is used as a world-to-camera rotation."""
    camera = look_at(np.array([3.0, -2, 1]), np.zeros(3), np.array([0.0, 0, 1]), INTRINSICS, 64, 48)
    pixels, depth = camera.project(np.zeros((1, 3)))
    np.testing.assert_allclose(pixels[0], [32, 24], atol=1e-9)
    np.testing.assert_allclose(depth[0], np.sqrt(14))


def test_the_field_of_view_spans_the_height() -> None:
    """Catches a field of view that is taken as horizontal, or as half of the angle, and a default pose that is not the
    identity."""
    camera = Camera.from_fov(60, 200, 100)
    pixels, _ = camera.project(np.array([[0, np.tan(np.radians(30)), 1], [0, 0, 2]]))
    np.testing.assert_allclose(pixels, [[100, 100], [100, 50]], atol=1e-9)
    np.testing.assert_allclose(camera.rotation, np.eye(3), atol=1e-12)
    placed = Camera.from_fov(60, 200, 100, centre=(3, -2, 1), target=(0, 0, 0), up=(0, 0, 1))
    np.testing.assert_allclose(placed.centre, [3, -2, 1], atol=1e-12)
    np.testing.assert_allclose(placed.project(np.zeros((1, 3)))[0], [[100, 50]], atol=1e-9)
    for angle in (0, 180, np.nan):
        with pytest.raises(ValueError, match="fov_y: expected degrees between 0 and 180"):
            Camera.from_fov(angle, 200, 100)
    with pytest.raises(ValueError, match="target: expected a point that differs"):
        Camera.from_fov(60, 200, 100, target=(0, 0, 0))


def test_unprojection_is_the_inverse_of_projection() -> None:
    """Catches a transposed rotation, and depths along the ray instead of along the optical axis."""
    camera = look_at(np.array([3.0, -2, 1]), np.zeros(3), np.array([0.0, 0, 1]), INTRINSICS, 64, 48)
    xyz = np.array([[0.3, -0.2, 0.4], [-0.5, 0.1, -0.3], [0.0, 0.6, 0.2]])
    np.testing.assert_allclose(camera.unproject(*camera.project(xyz)), xyz, atol=1e-12)


def test_world_up_is_image_up() -> None:
    """Catches a flipped y axis (OpenGL's convention)."""
    camera = look_at(np.array([3.0, 0, 0]), np.zeros(3), np.array([0.0, 0, 1]), INTRINSICS, 64, 48)
    pixels, _ = camera.project(np.array([[0.0, 0, 0.5]]))
    assert pixels[0, 1] < 24


def test_rescaling_scales_the_projection() -> None:
    """Catches a half-pixel error from scaling the intrinsics as if pixel centres had integer coordinates."""
    camera = Camera(INTRINSICS, np.eye(3), np.zeros(3), 64, 48)
    point = np.array([[0.1, 0.05, 1.0]])
    full, _ = camera.project(point)
    half, _ = camera.rescale(0.5).project(point)
    np.testing.assert_allclose(half, full / 2)


def test_cropping_shifts_the_projection() -> None:
    """Catches a crop offset that is applied to the wrong axis or with the wrong sign."""
    camera = Camera(INTRINSICS, np.eye(3), np.zeros(3), 64, 48)
    point = np.array([[0.1, 0.05, 1.0]])
    full, _ = camera.project(point)
    part, _ = camera.crop(5, 7, 20, 20).project(point)
    np.testing.assert_allclose(part, full - [5, 7])


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("rotation", np.diag([1.0, 1, -1]), "rotation: expected a rotation of determinant .1, got a reflection"),
        ("rotation", np.full((3, 3), np.nan), "rotation: expected finite"),
        ("rotation", np.array([[1e200, -1e200, 0], [1e200, 1e200, 0], [0, 0, 1]]), "rotation: expected an orthonormal"),
        ("intrinsics", np.diag([-1.0, 1, 1]), "intrinsics: expected positive focal"),
        ("translation", np.zeros(4), "translation: expected shape"),
        ("width", 0, "width and height"),
        ("distortion", np.zeros(3), "distortion: expected 4, 5"),
    ],
)
def test_invalid_fields_are_named(field: str, value: object, words: str) -> None:
    """Catches a camera that is created from invalid values without an error."""
    fields = {
        "intrinsics": INTRINSICS,
        "rotation": np.eye(3),
        "translation": np.zeros(3),
        "width": 64,
        "height": 48,
        "distortion": None,
    }
    with pytest.raises(ValueError, match=words):
        Camera(**{**fields, field: value})


def test_nearest_views_are_chosen_by_angle_not_distance() -> None:
    """Catches a choice of source views by distance, which prefers a near camera on another side to a distant camera on
    the same side."""
    up = np.array([0.0, 0, 1])
    target = look_at(np.array([2.0, 0, 0]), np.zeros(3), up, INTRINSICS, 64, 48)
    same_side_far = look_at(np.array([9.0, 0.1, 0]), np.zeros(3), up, INTRINSICS, 64, 48)
    other_side_near = look_at(np.array([0.0, 2, 0]), np.zeros(3), up, INTRINSICS, 64, 48)
    assert nearest_views(target, [other_side_near, same_side_far], 1, np.zeros(3)) == [1]


def at_degrees(degrees: float, radius: float = 2.0) -> Camera:
    """A camera on a circle around the origin, at an angle from the x axis."""
    angle = np.radians(degrees)
    centre = radius * np.array([np.cos(angle), np.sin(angle), 0])
    return look_at(centre, np.zeros(3), np.array([0.0, 0, 1]), INTRINSICS, 64, 48)


def test_view_weights_fall_to_zero_at_the_first_view_that_is_left_out() -> None:
    """Catches view weights that are linear in the cosine instead of the angle, and weights that reach 0 at a selected
    view.
    """
    sources = [at_degrees(degrees, radius) for degrees, radius in [(-10, 2), (20, 5), (40, 2), (-50, 3), (90, 2)]]
    views = select_views(at_degrees(0), sources, 3, np.zeros(3), fade=True)
    assert views.indices == [0, 1, 2]
    np.testing.assert_allclose(views.weights, [0.8, 0.6, 0.2], atol=1e-6)
    even = select_views(at_degrees(0), sources, 3, np.zeros(3), fade=False)
    assert (even.indices, even.weights.tolist()) == ([0, 1, 2], [1, 1, 1])


def test_the_limit_is_beyond_all_chosen_views() -> None:
    """Catches negative view weights in training. A training step may leave out one of the nearest views, because it is
    the target view."""
    sources = [at_degrees(degrees) for degrees in (10, 20, 30, 40, 60)]
    np.testing.assert_allclose(fading_weights(at_degrees(0), sources, [0, 1, 3], np.zeros(3)), [5 / 6, 4 / 6, 2 / 6])


@pytest.mark.parametrize(
    ("degrees", "weights"), [([10, 20], [0.6, 0.2]), ([0, 0], [1, 1]), ([30, -30], [0.2, 0.2]), ([], [])]
)
def test_view_weights_without_other_views(degrees: list[float], weights: list[float]) -> None:
    """Catches divisions by zero, and weights that are all 0."""
    sources = [at_degrees(each) for each in degrees]
    views = select_views(at_degrees(0), sources, 4, np.zeros(3), fade=True)
    np.testing.assert_allclose(views.weights, weights, atol=1e-6)


def test_views_at_equal_angles_keep_a_weight() -> None:
    """Catches a viewer whose selected views all have weight 0, because a left-out view has the same angle."""
    sources = [at_degrees(30), at_degrees(-30)]
    np.testing.assert_allclose(select_views(at_degrees(0), sources, 1, np.zeros(3), fade=True).weights, [1])
