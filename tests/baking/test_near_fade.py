"""The fade of points at the near plane, in the players on the CPU."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.play.near_fade import fade_near
from fourd.rendering.ops.points.arrays import render_points_numpy
from fourd.scene.player import Player
from fourd.scene.rendering import render_frame
from fourd.scene.scene import BakedFrame
from fourd.scene.shade import shade
from tests.baking.scenes import NEAR_IN_BALL, manifest, random_frame, ring
from tests.baking.test_player import draw_reference

NEAR = 0.3
STEP = 0.01 * NEAR
DESCRIBED = replace(manifest(views=1), near=NEAR, pixel_filter=0.0)


def test_the_fade_has_its_documented_values() -> None:
    """Catches a fade that starts or ends at another depth, or that is measured along the ray instead of the axis."""
    camera = Camera(np.array([[60.0, 0, 24], [0, 60, 24], [0, 0, 1]]), np.eye(3), np.zeros(3), 48, 48)
    depths = np.array([-1, 0, 0.5, 1, 1.125, 1.25, 1.4, 1.5, 9]) * 0.2
    xyz = np.stack([np.full_like(depths, 0.1), np.zeros_like(depths), depths], axis=1).astype(np.float32)
    expected = np.array([0, 0, 0, 0, 0.25, 0.5, 0.8, 1, 1])
    np.testing.assert_allclose(fade_near(xyz, np.full(9, 0.6, np.float32), camera, 0.2), 0.6 * expected, atol=1e-5)
    np.testing.assert_allclose(fade_near(xyz, np.full(9, 3.0, np.float32), camera, 0.2), expected, atol=1e-5)


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
def test_players_fade_as_the_reference_does(simd: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a player that cuts points off at the near plane, and densities that are clamped after the fade."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    frame, described = random_frame(2000, 6, seed=1), replace(manifest(views=6), near=NEAR_IN_BALL)
    frame = replace(frame, density=(2 * frame.density).astype(np.float16))
    for camera in ring(3):
        truth = draw_reference(frame, camera, described, described.layers)
        assert np.abs(Player().draw(frame, camera, described).astype(float) - 255 * truth).max() <= 1.0
        assert np.abs(render_frame(frame, camera, described).rgb - truth[..., :3]).max() <= 1e-4
        assert np.abs(cut(frame, camera, described.near) - truth[..., :3]).max() > 0.1


def test_walking_up_to_a_wall_changes_the_picture_gradually() -> None:
    """Catches points that pop out when they cross the near plane. The hard cut of the training renderer does this."""
    frame, cameras = wall(), [at_depth(depth) for depth in np.arange(1.7 * NEAR, 0.8 * NEAR, -STEP)]
    player = Player()
    played = [player.draw(frame, camera, DESCRIBED)[..., :3] / 255 for camera in cameras]
    assert largest_change(played) < 0.15
    assert largest_change([cut(frame, camera, NEAR) for camera in cameras]) > 0.5
    assert played[0].mean() > 0.75, "the wall covers the image at the start"
    assert played[-1].max() == 0, "and is gone at the end"


def wall() -> BakedFrame:
    """A grey wall in the plane z = 0, with about five points in front of each other at every pixel."""
    grid = np.linspace(-0.6, 0.6, 81)
    xyz = np.stack([*np.meshgrid(grid, grid), np.zeros((81, 81))], axis=-1).reshape(-1, 3).astype(np.float32)
    count = len(xyz)
    return BakedFrame(
        xyz=xyz,
        radius=np.full(count, 0.02, np.float16),
        density=np.full(count, 0.9, np.float16),
        sh=np.zeros((count, 3, 16), np.float16),
        blend_weights=np.ones((count, 1), np.float16),
        rgb=np.full((count, 1, 3), 220, np.uint8),
    )


def at_depth(depth: float) -> Camera:
    """A camera that looks along the z axis, at this distance from the wall."""
    intrinsics = np.array([[24.0, 0, 12], [0, 24, 12], [0, 0, 1]])
    return Camera(intrinsics, np.eye(3), np.array([0.0, 0, depth]), 24, 24)


def cut(frame: BakedFrame, camera: Camera, near: float) -> NDArray[np.float32]:
    """The picture with a hard cut at the near plane, as training renders it."""
    described = replace(manifest(views=frame.view_count), near=near)
    sizes = (frame.radius.astype(np.float32), frame.density.astype(np.float32))
    colours = shade(frame, camera, described)
    rgb, _, _ = render_points_numpy(frame.xyz, colours, *sizes, camera, layers=described.layers, near=near)
    return rgb.clip(0, 1)


def largest_change(pictures: list[NDArray[np.floating]]) -> float:
    """The largest change of a pixel from one picture to the next."""
    return max(float(np.abs(after - before).max()) for before, after in pairwise(pictures))
