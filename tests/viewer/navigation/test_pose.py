"""Poses: they see what capture cameras see, and move as they are dragged."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fourd.cameras import Camera, look_at
from fourd.viewer.navigation.pose import (
    MAX_FIELD_OF_VIEW,
    MIN_FIELD_OF_VIEW,
    Pose,
    interpolate_poses,
    pose_facing,
    pose_from_camera,
)

Array = NDArray[np.float64]

UP = np.array([0.0, 0.0, 1.0])
SIZE = (160, 90)
SHIFTS = [(0.0, 0.0), (5.5, -3.25)]


def capture(width: int, height: int, shift: tuple[float, float] = (0.0, 0.0), aspect: float = 1.0) -> Camera:
    """A camera that looks past the origin; its principal point lies off the centre, its pixels may be oblong."""
    focal = 1.3 * height
    intrinsics = np.array(
        [[aspect * focal, 0, width / 2 + shift[0]], [0, focal, height / 2 + shift[1]], [0, 0, 1.0]],
    )
    return look_at(np.array([2.0, -1.5, 0.7]), np.array([0.1, 0.2, 0.3]), UP, intrinsics, width, height)


def viewer(seed: int = 0, offset: tuple[float, float] = (0.04, -0.02)) -> Pose:
    """Somewhere around the origin, level, with an eccentric principal point."""
    rng = np.random.default_rng(seed)
    pose = pose_facing(rng.uniform([2, 2, -1], [3, 3, 1]), rng.uniform(-0.2, 0.2, 3), UP, 0.9)
    return Pose(pose.pivot, pose.rotation, pose.distance, pose.field_of_view, UP, offset)


def rolled(pose: Pose, degrees: float) -> Pose:
    """The same pose with its head tilted."""
    roll = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return Pose(pose.pivot, roll @ pose.rotation, pose.distance, pose.field_of_view, pose.up, pose.offset)


def pixel(pose: Pose, point: Array) -> Array:
    """Where a point is seen in a picture of SIZE."""
    pixels, depths = pose.camera(*SIZE).project(point[None])
    assert depths[0] > 0
    return pixels[0]


def assert_rotation(rotation: Array) -> None:
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(rotation) > 0


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("size", [(64, 48), (48, 64)])
def test_a_capture_camera_comes_back(size: tuple[int, int], shift: tuple[float, float]) -> None:
    """Catches a jump between a capture's picture and the viewer's: a lost principal point, or a field of view."""
    camera = capture(*size, shift)
    again = pose_from_camera(camera, (0.0, 0.0, 0.0), UP, size).camera(*size)
    assert (again.width, again.height) == size
    np.testing.assert_allclose(again.intrinsics, camera.intrinsics, rtol=1e-12)
    np.testing.assert_array_equal(again.rotation, camera.rotation)
    np.testing.assert_allclose(again.translation, camera.translation, atol=1e-12)


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("size", [(128, 96), (300, 48), (40, 90), (33, 17)])
def test_another_shape_shows_all_of_a_capture_camera(size: tuple[int, int], shift: tuple[float, float]) -> None:
    """Catches cropped heads in a window of another shape, a picture that is too small, and one off the middle."""
    low, high = corners_seen(capture(64, 48, shift), size)
    assert (low > -1e-9).all()
    assert (high < np.array(size) + 1e-9).all()
    assert np.abs(low + high - size).max() < 1e-9
    assert ((high - low) / size).max() == pytest.approx(1)


@pytest.mark.parametrize("aspect", [0.8, 1.25])
def test_oblong_pixels_cut_nothing_off(aspect: float) -> None:
    """Catches a focal length taken from one axis where the other sees wider."""
    low, high = corners_seen(capture(64, 48, aspect=aspect), (64, 48))
    assert (low > -1e-9).all()
    assert (high < np.array((64, 48)) + 1e-9).all()


def corners_seen(camera: Camera, size: tuple[int, int]) -> tuple[Array, Array]:
    """The rectangle, low and high, in which the pose of a camera sees the camera's picture."""
    corners = np.array([[x, y, 1.0] for x in (0, camera.width) for y in (0, camera.height)])
    rays = 2.0 * corners @ np.linalg.inv(camera.intrinsics).T
    points = (rays - camera.translation) @ camera.rotation
    pixels, _ = pose_from_camera(camera, (0.0, 0.0, 0.0), UP, size).camera(*size).project(points)
    return pixels.min(axis=0), pixels.max(axis=0)


def test_the_pivot_is_where_the_view_passes_the_focus() -> None:
    """Catches orbits round a point beside the subject, or at another depth."""
    camera, focus = capture(64, 48), np.array([0.3, -0.4, 0.1])
    pose = pose_from_camera(camera, focus, UP, (64, 48))
    assert abs((focus - pose.pivot) @ camera.forward) < 1e-12
    np.testing.assert_allclose(np.cross(pose.pivot - camera.centre, camera.forward), 0, atol=1e-12)
    np.testing.assert_allclose(pose.eye, camera.centre, atol=1e-12)


@pytest.mark.parametrize("ahead", [-3.0, 0.0, 1e-9, np.nan])
def test_a_focus_that_is_not_ahead(ahead: float) -> None:
    """Catches a viewer that is turned about or stands in its pivot, where a camera looks away from the scene."""
    camera = capture(64, 48)
    pose = pose_from_camera(camera, camera.centre + ahead * camera.forward, UP, (64, 48))
    assert pose.distance > 0.1
    assert (pose.pivot - camera.centre) @ camera.forward > 0
    np.testing.assert_allclose(pose.camera(64, 48).translation, camera.translation, atol=1e-12)


def test_facing_looks_at_the_pivot_with_up_on_top() -> None:
    """Catches a start that looks away or stands on its head."""
    eye, pivot = np.array([1.0, 2.0, 3.0]), np.array([0.2, 0.1, -0.3])
    pose = pose_facing(eye, pivot, UP, 0.8)
    np.testing.assert_allclose(pose.eye, eye, atol=1e-12)
    np.testing.assert_allclose(pixel(pose, pivot), np.array(SIZE) / 2, atol=1e-9)
    assert pixel(pose, pivot + 0.1 * UP)[1] < SIZE[1] / 2


def test_orbits_keep_the_pivot_in_its_pixel() -> None:
    """Catches a turn about the eye or the origin, and a drift away from the pivot."""
    rng = np.random.default_rng(1)
    pose = viewer()
    place = pixel(pose, pose.pivot)
    for right, down in rng.uniform(-1, 1, (50, 2)):
        turned = pose.orbit(right, down)
        assert np.abs(pixel(turned, pose.pivot) - place).max() < 1e-6
        assert np.linalg.norm(turned.eye - pose.pivot) == pytest.approx(pose.distance)
        pose = turned


def test_orbits_drag_what_is_in_front_of_the_pivot_with_the_mouse() -> None:
    """Catches an axis turned the wrong way round, and the two mixed up."""
    pose = viewer()
    point = pose.pivot - 0.3 * pose.distance * pose.rotation[2]
    before = pixel(pose, point)
    right, down = pixel(pose.orbit(0.05, 0), point) - before, pixel(pose.orbit(0, 0.05), point) - before
    assert right[0] > 1 > abs(right[1])
    assert down[1] > 1 > abs(down[0])


def test_an_orbit_turns_by_the_asked_angle() -> None:
    """Catches half or double angles, and degrees taken for radians."""
    pose = pose_facing(np.array([3.0, 0.0, 0.0]), np.zeros(3), UP, 0.9)
    np.testing.assert_allclose(pose.orbit(0.4, 0).eye, 3 * np.array([np.cos(0.4), -np.sin(0.4), 0]), atol=1e-12)
    np.testing.assert_allclose(pose.orbit(0, 0.4).eye, 3 * np.array([np.cos(0.4), 0, np.sin(0.4)]), atol=1e-12)
    np.testing.assert_allclose(pose.orbit(0, 0).rotation, pose.rotation, atol=1e-12)


@pytest.mark.parametrize("down", [0.03, -0.03, 2.0, -2.0])
@pytest.mark.parametrize("roll", [0.0, 5.0])
def test_orbits_never_pass_a_pole(roll: float, down: float) -> None:
    """Catches a picture that stands on its head after a long drag, also from a camera that is a little tilted."""
    pose = rolled(viewer(), roll)
    for _ in range(200):
        pose = pose.orbit(0.01, down)
        assert -pose.rotation[1] @ UP > 0
        assert abs(pose.rotation[2] @ UP) < 1
    assert -np.sign(down) * pose.rotation[2] @ UP > 0.98


def test_a_viewer_at_a_pole_is_not_thrown_away_from_it() -> None:
    """Catches a camera on the ceiling that jumps at its first touch, or that cannot be turned any more."""
    straight_down = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    pose = Pose(np.zeros(3), straight_down, 2.0, 0.9, UP)
    np.testing.assert_allclose(pose.orbit(0, 0.1).rotation, straight_down, atol=1e-9)
    raised = pose.orbit(0, -0.1)
    assert np.arccos(-raised.rotation[2] @ UP) == pytest.approx(0.1)
    assert -raised.rotation[1] @ UP > 0
    assert_rotation(pose.orbit(0.3, 0).rotation)


def test_thousands_of_turns_leave_a_rotation() -> None:
    """Catches rounding that adds up until the camera is refused."""
    pose = viewer()
    for right, down in np.random.default_rng(2).normal(0, 0.3, (2000, 2)):
        pose = pose.orbit(right, down)
    assert_rotation(pose.rotation)
    assert -pose.rotation[1] @ UP > 0
    pose.camera(*SIZE)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_pans_drag_the_pivot_with_the_mouse(scale: float) -> None:
    """Catches pans of a fixed speed, which are lost in large scenes, and the wrong direction."""
    pose = viewer().dolly(scale)
    moved = pose.pan(0.25, -0.1)
    step = pixel(moved, pose.pivot) - pixel(pose, pose.pivot)
    np.testing.assert_allclose(step, [0.25 * SIZE[1], -0.1 * SIZE[1]], atol=1e-6)
    np.testing.assert_array_equal(moved.rotation, pose.rotation)
    assert moved.distance == pose.distance


def test_dollies_come_nearer_without_passing_the_pivot() -> None:
    """Catches a dolly that moves the pivot, goes through it, or gets stuck at 0 or infinity."""
    pose = viewer()
    nearer = pose.dolly(0.5)
    np.testing.assert_allclose(nearer.eye, (pose.eye + pose.pivot) / 2, atol=1e-12)
    np.testing.assert_array_equal(nearer.pivot, pose.pivot)
    for factor in (1e-30, 1e30):
        end = pose.dolly(factor)
        for _ in range(3):
            end = end.dolly(factor)
        assert 0 < end.distance < np.inf
        assert end.dolly(1 / pose.distance).camera(*SIZE)
        assert (end.dolly(1 / factor).distance < end.distance) == (factor > 1)


def test_flights_follow_the_viewers_own_axes() -> None:
    """Catches keys that move along the world's axes, up and down the wrong way, and a pivot left behind."""
    pose, point = viewer(), np.array([0.1, -0.2, 0.3])
    moved = pose.fly(0.3, 0.2, 0.1)
    before, after = (
        camera.rotation @ point + camera.translation for camera in (pose.camera(*SIZE), moved.camera(9, 9))
    )
    np.testing.assert_allclose(after - before, [-0.3, 0.2, -0.1], atol=1e-12)
    np.testing.assert_allclose(moved.pivot - moved.eye, pose.pivot - pose.eye, atol=1e-12)
    assert moved.distance == pose.distance


def test_the_field_of_view_stays_in_its_range() -> None:
    """Catches a slider's end that gives a focal length of 0 or infinity, and a view that moves while it widens."""
    pose = viewer()
    assert pose.with_field_of_view(0.0).field_of_view == MIN_FIELD_OF_VIEW
    assert pose.with_field_of_view(10.0).field_of_view == MAX_FIELD_OF_VIEW
    assert pose.with_field_of_view(1.2).field_of_view == 1.2
    for angle in (0.0, 1.2, 10.0):
        np.testing.assert_allclose(
            pixel(pose.with_field_of_view(angle), pose.pivot), pixel(pose, pose.pivot), atol=1e-9
        )


def test_a_glide_begins_and_ends_exactly() -> None:
    """Catches a jump at either end of a glide."""
    start, end = viewer(1), viewer(2, offset=(-0.1, 0.05)).with_field_of_view(0.5).dolly(3)
    first, last = interpolate_poses(start, end, 0.0), interpolate_poses(start, end, 1.0)
    for pose, expected in ((first, start), (last, end)):
        got, wanted = pose.camera(*SIZE), expected.camera(*SIZE)
        np.testing.assert_allclose(got.intrinsics, wanted.intrinsics, rtol=1e-12)
        np.testing.assert_allclose(got.rotation, wanted.rotation, atol=1e-12)
        np.testing.assert_allclose(got.translation, wanted.translation, atol=1e-12)
        np.testing.assert_allclose(pose.pivot, expected.pivot, atol=1e-12)
    assert last is end


@pytest.mark.parametrize("turn", [0.0, 1e-9, 1.0, np.pi])
def test_a_glide_stays_a_view_on_its_way(turn: float) -> None:
    """Catches NaN between equal or opposite directions, a time past the end, and a way that turns back."""
    start = viewer()
    end = start.orbit(turn, 0.2).dolly(1e4)
    shares = [*np.linspace(0, 1, 21), np.nextafter(1, 0)]
    poses = [interpolate_poses(start, end, float(share)) for share in shares]
    for pose in poses:
        pose.camera(*SIZE)
        assert_rotation(pose.rotation)
    distances = [pose.distance for pose in poses[:-1]]
    assert distances == sorted(distances)
    assert distances[10] == pytest.approx(np.sqrt(start.distance * end.distance))
