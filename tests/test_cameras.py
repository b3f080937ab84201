"""The camera conventions that the whole package relies on."""

import numpy as np
import pytest

from fourd.cameras import Camera, look_at, nearest_views

INTRINSICS = np.array([[100.0, 0, 32], [0, 110, 24], [0, 0, 1]])


def test_point_on_the_axis_projects_to_the_principal_point() -> None:
    """Catches a camera-to-world rotation that is used as a world-to-camera rotation."""
    camera = look_at(np.array([3.0, -2, 1]), np.zeros(3), np.array([0.0, 0, 1]), INTRINSICS, 64, 48)
    pixels, depth = camera.project(np.zeros((1, 3)))
    np.testing.assert_allclose(pixels[0], [32, 24], atol=1e-9)
    np.testing.assert_allclose(depth[0], np.sqrt(14))


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
        ("rotation", np.diag([1.0, 1, -1]), "rotation: expected an orthonormal"),
        ("rotation", np.full((3, 3), np.nan), "rotation: expected finite"),
        ("rotation", np.array([[1e200, -1e200, 0], [1e200, 1e200, 0], [0, 0, 1]]), "rotation: expected an orthonormal"),
        ("intrinsics", np.diag([-1.0, 1, 1]), "intrinsics: expected positive focal"),
        ("translation", np.zeros(4), "translation: expected shape"),
        ("width", 0, "width and height"),
        ("distortion", np.zeros(3), "distortion: expected 4, 5"),
    ],
)
def test_invalid_fields_are_named(field: str, value: object, words: str) -> None:
    """Catches invalid values from which a camera is created without an error."""
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
