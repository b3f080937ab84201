"""Where a captured picture is in the window."""

from __future__ import annotations

import numpy as np

from fourd.viewer.comparison.placement import area_of_picture, find_view, fitted
from fourd.viewer.interface.layout import Area
from fourd.viewer.navigation.pose import pose_from_camera
from tests.baking.scenes import ring

SIZE = (900, 500)
UP = np.array([0.0, 0.0, 1.0])


def test_a_picture_lies_over_the_scene_at_each_zoom() -> None:
    """Catches a captured picture that is shifted or scaled against the scene, at first or after the user has enlarged
    the image."""
    view = ring(3)[1]
    pose = pose_from_camera(view, (0, 0, 0), UP, SIZE, room=(400, 500))
    xyz = np.random.default_rng(1).normal(0, 0.3, (20, 3))
    pixels = view.project(xyz)[0]
    for each in (pose, pose.zoom(3, 0.2, -0.1), pose.zoom(3, 0.2, -0.1).slide(-0.3, 0.05)):
        shown = each.camera(*SIZE, (150.0, -20.0))
        area = area_of_picture(view, shown)
        placed = np.array([area.left, area.top]) + pixels * [area.width / view.width, area.height / view.height]
        assert np.abs(placed - shown.project(xyz)[0]).max() < 1e-6


def test_a_zoom_keeps_the_point_under_the_mouse() -> None:
    """Catches a zoom around the middle of the window, and a limit at which the image moves instead."""
    pose = pose_from_camera(ring(3)[1], (0, 0, 0), UP, SIZE)
    x, y = 0.3, -0.2
    mouse = np.array([x * SIZE[1] + SIZE[0] / 2, y * SIZE[1] + SIZE[1] / 2])

    def ray(camera):
        return np.linalg.solve(camera.intrinsics, [*mouse, 1.0])

    for factor in (2.0, 0.7, 1e4):
        zoomed = pose.zoom(factor, x, y)
        assert np.allclose(ray(zoomed.camera(*SIZE)), ray(pose.camera(*SIZE)), atol=1e-6)
        assert np.array_equal(zoomed.eye, pose.eye)


def test_only_the_view_of_a_camera_is_compared() -> None:
    """Catches a picture that is drawn over another view, and a view that a saved pose or a zoom no longer matches."""
    cameras = ring(4)
    pose = pose_from_camera(cameras[2], (0, 0, 0), UP, SIZE)
    assert find_view(cameras, pose.camera(*SIZE), pose.distance, preferred=0) == 2
    assert find_view(cameras, pose.zoom(2, 0, 0).camera(*SIZE), pose.distance, preferred=9) == 2
    for moved in (pose.orbit(0.01, 0), pose.dolly(0.99), pose.pan(0.01, 0)):
        assert find_view(cameras, moved.camera(*SIZE), pose.distance, preferred=2) is None
    twins = (*cameras, cameras[2])
    assert find_view(twins, pose.camera(*SIZE), pose.distance, preferred=4) == 4


def test_a_picture_keeps_its_proportions_beside_another_view() -> None:
    """Catches a stretched picture."""
    assert fitted((300, 100), Area(10, 20, 60, 60)) == Area(10, 40, 60, 20)
