"""Poses: conversion from capture cameras, and motion by mouse and keys."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fourd.base.cameras import Camera, look_at
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


def capture_camera(width: int, height: int, shift: tuple[float, float] = (0.0, 0.0), aspect: float = 1.0) -> Camera:
    """A camera whose principal point is off-centre by ``shift`` and whose axis misses the origin. With ``aspect`` 1,
    the pixels are square."""
    focal = 1.3 * height
    intrinsics = np.array(
        [[aspect * focal, 0, width / 2 + shift[0]], [0, focal, height / 2 + shift[1]], [0, 0, 1.0]],
    )
    return look_at(np.array([2.0, -1.5, 0.7]), np.array([0.1, 0.2, 0.3]), UP, intrinsics, width, height)


def make_pose(seed: int = 0, offset: tuple[float, float] = (0.04, -0.02)) -> Pose:
    """A pose around the origin, without roll, with an off-centre principal point."""
    rng = np.random.default_rng(seed)
    pose = pose_facing(rng.uniform([2, 2, -1], [3, 3, 1]), rng.uniform(-0.2, 0.2, 3), UP, 0.9)
    return Pose(pose.pivot, pose.rotation, pose.distance, pose.field_of_view, UP, offset)


def roll_pose(pose: Pose, degrees: float) -> Pose:
    """Rotate a pose about its viewing axis."""
    roll = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return Pose(pose.pivot, roll @ pose.rotation, pose.distance, pose.field_of_view, pose.up, pose.offset)


def project(pose: Pose, point: Array) -> Array:
    """Pixel position (2,) of a point in an image of the size SIZE."""
    pixels, depths = pose.camera(*SIZE).project(point[None])
    assert depths[0] > 0
    return pixels[0]


def assert_rotation(rotation: Array) -> None:
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(rotation) > 0


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("size", [(64, 48), (48, 64)])
def test_a_capture_camera_survives_the_round_trip(size: tuple[int, int], shift: tuple[float, float]) -> None:
    """Catches a principal point or a field of view that changes between camera and pose."""
    camera = capture_camera(*size, shift)
    again = pose_from_camera(camera, (0.0, 0.0, 0.0), UP, size).camera(*size)
    assert (again.width, again.height) == size
    np.testing.assert_allclose(again.intrinsics, camera.intrinsics, rtol=1e-12)
    np.testing.assert_array_equal(again.rotation, camera.rotation)
    np.testing.assert_allclose(again.translation, camera.translation, atol=1e-12)


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("size", [(128, 96), (300, 48), (40, 90), (33, 17)])
def test_other_aspect_ratios_contain_the_capture_image(size: tuple[int, int], shift: tuple[float, float]) -> None:
    """Catches an image that is cropped, too small or off-centre in a window of another aspect ratio."""
    low, high = image_rectangle(capture_camera(64, 48, shift), size)
    assert (low > -1e-9).all()
    assert (high < np.array(size) + 1e-9).all()
    assert np.abs(low + high - size).max() < 1e-9
    assert ((high - low) / size).max() == pytest.approx(1)


@pytest.mark.parametrize("aspect", [0.8, 1.25])
def test_non_square_pixels_are_not_cropped(aspect: float) -> None:
    """Catches non-square pixels whose field of view is computed from the wrong axis, so that the image is cropped."""
    low, high = image_rectangle(capture_camera(64, 48, aspect=aspect), (64, 48))
    assert (low > -1e-9).all()
    assert (high < np.array((64, 48)) + 1e-9).all()


def image_rectangle(camera: Camera, size: tuple[int, int]) -> tuple[Array, Array]:
    """Lower and upper corner of the image of ``camera``, as positions in the image of the camera's pose."""
    corners = np.array([[x, y, 1.0] for x in (0, camera.width) for y in (0, camera.height)])
    rays = 2.0 * corners @ np.linalg.inv(camera.intrinsics).T
    points = (rays - camera.translation) @ camera.rotation
    pixels, _ = pose_from_camera(camera, (0.0, 0.0, 0.0), UP, size).camera(*size).project(points)
    return pixels.min(axis=0), pixels.max(axis=0)


def test_the_pivot_is_the_axis_point_nearest_to_the_focus() -> None:
    """Catches a pivot that is off the camera axis, or whose depth differs from that of the focus point."""
    camera, focus = capture_camera(64, 48), np.array([0.3, -0.4, 0.1])
    pose = pose_from_camera(camera, focus, UP, (64, 48))
    assert abs((focus - pose.pivot) @ camera.forward) < 1e-12
    np.testing.assert_allclose(np.cross(pose.pivot - camera.centre, camera.forward), 0, atol=1e-12)
    np.testing.assert_allclose(pose.eye, camera.centre, atol=1e-12)


@pytest.mark.parametrize("depth", [-3.0, 0.0, 1e-9, np.nan])
def test_a_focus_behind_the_camera_is_replaced(depth: float) -> None:
    """Catches a reversed pose, or a pose at its own pivot, if a camera faces away from the scene."""
    camera = capture_camera(64, 48)
    pose = pose_from_camera(camera, camera.centre + depth * camera.forward, UP, (64, 48))
    assert pose.distance > 0.1
    assert (pose.pivot - camera.centre) @ camera.forward > 0
    np.testing.assert_allclose(pose.camera(64, 48).translation, camera.translation, atol=1e-12)


def test_pose_facing_is_centred_and_upright() -> None:
    """Catches a pose that faces away from its pivot or is upside down."""
    eye, pivot = np.array([1.0, 2.0, 3.0]), np.array([0.2, 0.1, -0.3])
    pose = pose_facing(eye, pivot, UP, 0.8)
    np.testing.assert_allclose(pose.eye, eye, atol=1e-12)
    np.testing.assert_allclose(project(pose, pivot), np.array(SIZE) / 2, atol=1e-9)
    assert project(pose, pivot + 0.1 * UP)[1] < SIZE[1] / 2


def test_orbits_keep_the_pivot_in_its_project() -> None:
    """Catches orbits that rotate about the eye or the origin, or that change the distance to the pivot."""
    rng = np.random.default_rng(1)
    pose = make_pose()
    start = project(pose, pose.pivot)
    for right, down in rng.uniform(-1, 1, (50, 2)):
        turned = pose.orbit(right, down)
        assert np.abs(project(turned, pose.pivot) - start).max() < 1e-6
        assert np.linalg.norm(turned.eye - pose.pivot) == pytest.approx(pose.distance)
        pose = turned


def test_orbits_move_points_in_front_of_the_pivot_with_the_mouse() -> None:
    """Catches orbits about a wrong axis or in the wrong direction."""
    pose = make_pose()
    point = pose.pivot - 0.3 * pose.distance * pose.rotation[2]
    before = project(pose, point)
    right, down = project(pose.orbit(0.05, 0), point) - before, project(pose.orbit(0, 0.05), point) - before
    assert right[0] > 1 > abs(right[1])
    assert down[1] > 1 > abs(down[0])


def test_orbits_rotate_by_the_given_angle() -> None:
    """Catches orbits by half or twice the given angle, and degrees that are used as radians."""
    pose = pose_facing(np.array([3.0, 0.0, 0.0]), np.zeros(3), UP, 0.9)
    np.testing.assert_allclose(pose.orbit(0.4, 0).eye, 3 * np.array([np.cos(0.4), -np.sin(0.4), 0]), atol=1e-12)
    np.testing.assert_allclose(pose.orbit(0, 0.4).eye, 3 * np.array([np.cos(0.4), 0, np.sin(0.4)]), atol=1e-12)
    np.testing.assert_allclose(pose.orbit(0, 0).rotation, pose.rotation, atol=1e-12)


@pytest.mark.parametrize("down", [0.03, -0.03, 2.0, -2.0])
@pytest.mark.parametrize("roll", [0.0, 5.0])
def test_orbits_stop_at_the_poles(roll: float, down: float) -> None:
    """Catches an image that is upside down after a long drag, also if the initial camera has a roll."""
    pose = roll_pose(make_pose(), roll)
    for _ in range(200):
        pose = pose.orbit(0.01, down)
        assert -pose.rotation[1] @ UP > 0
        assert abs(pose.rotation[2] @ UP) < 1
    assert -np.sign(down) * pose.rotation[2] @ UP > 0.98


def test_a_pose_at_a_pole_can_leave_it_smoothly() -> None:
    """Catches a camera that looks straight down and jumps at the first drag, or cannot be rotated."""
    straight_down = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    pose = Pose(np.zeros(3), straight_down, 2.0, 0.9, UP)
    np.testing.assert_allclose(pose.orbit(0, 0.1).rotation, straight_down, atol=1e-9)
    raised = pose.orbit(0, -0.1)
    assert np.arccos(-raised.rotation[2] @ UP) == pytest.approx(0.1)
    assert -raised.rotation[1] @ UP > 0
    assert_rotation(pose.orbit(0.3, 0).rotation)


def test_thousands_of_orbits_keep_a_valid_rotation() -> None:
    """Catches rounding errors that accumulate until the rotation is rejected as invalid."""
    pose = make_pose()
    for right, down in np.random.default_rng(2).normal(0, 0.3, (2000, 2)):
        pose = pose.orbit(right, down)
    assert_rotation(pose.rotation)
    assert -pose.rotation[1] @ UP > 0
    pose.camera(*SIZE)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_pans_move_the_pivot_with_the_mouse(scale: float) -> None:
    """Catches pans with a constant speed in world units, and pans in the wrong direction."""
    pose = make_pose().dolly(scale)
    moved = pose.pan(0.25, -0.1)
    step = project(moved, pose.pivot) - project(pose, pose.pivot)
    np.testing.assert_allclose(step, [0.25 * SIZE[1], -0.1 * SIZE[1]], atol=1e-6)
    np.testing.assert_array_equal(moved.rotation, pose.rotation)
    assert moved.distance == pose.distance


def test_dollies_do_not_pass_the_pivot() -> None:
    """Catches a dolly that moves the pivot, passes through the pivot, or cannot leave a distance of 0 or infinity."""
    pose = make_pose()
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


def test_flying_follows_the_axes_of_the_pose() -> None:
    """Catches flying along the world axes, swapped up and down, and a pivot that does not move with the pose."""
    pose, point = make_pose(), np.array([0.1, -0.2, 0.3])
    moved = pose.fly(0.3, 0.2, 0.1)
    before, after = (
        camera.rotation @ point + camera.translation for camera in (pose.camera(*SIZE), moved.camera(9, 9))
    )
    np.testing.assert_allclose(after - before, [-0.3, 0.2, -0.1], atol=1e-12)
    np.testing.assert_allclose(moved.pivot - moved.eye, pose.pivot - pose.eye, atol=1e-12)
    assert moved.distance == pose.distance


def test_the_field_of_view_is_clamped() -> None:
    """Catches fields of view that give a focal length of 0 or infinity, and a pivot that moves in the image."""
    pose = make_pose()
    assert pose.with_field_of_view(0.0).field_of_view == MIN_FIELD_OF_VIEW
    assert pose.with_field_of_view(10.0).field_of_view == MAX_FIELD_OF_VIEW
    assert pose.with_field_of_view(1.2).field_of_view == 1.2
    for angle in (0.0, 1.2, 10.0):
        np.testing.assert_allclose(
            project(pose.with_field_of_view(angle), pose.pivot), project(pose, pose.pivot), atol=1e-9
        )


def test_interpolation_is_exact_at_both_ends() -> None:
    """Catches a jump at the start or the end of a transition between poses."""
    start, end = make_pose(1), make_pose(2, offset=(-0.1, 0.05)).with_field_of_view(0.5).dolly(3)
    first, last = interpolate_poses(start, end, 0.0), interpolate_poses(start, end, 1.0)
    for pose, expected in ((first, start), (last, end)):
        got, wanted = pose.camera(*SIZE), expected.camera(*SIZE)
        np.testing.assert_allclose(got.intrinsics, wanted.intrinsics, rtol=1e-12)
        np.testing.assert_allclose(got.rotation, wanted.rotation, atol=1e-12)
        np.testing.assert_allclose(got.translation, wanted.translation, atol=1e-12)
        np.testing.assert_allclose(pose.pivot, expected.pivot, atol=1e-12)
    assert last is end


@pytest.mark.parametrize("turn", [0.0, 1e-9, 1.0, np.pi])
def test_interpolated_poses_are_valid(turn: float) -> None:
    """Catches NaN in the interpolation between equal or opposite directions, extrapolation, and motion that
    reverses."""
    start = make_pose()
    end = start.orbit(turn, 0.2).dolly(1e4)
    fractions = [*np.linspace(0, 1, 21), np.nextafter(1, 0)]
    poses = [interpolate_poses(start, end, float(fraction)) for fraction in fractions]
    for pose in poses:
        pose.camera(*SIZE)
        assert_rotation(pose.rotation)
    distances = [pose.distance for pose in poses[:-1]]
    assert distances == sorted(distances)
    assert distances[10] == pytest.approx(np.sqrt(start.distance * end.distance))
