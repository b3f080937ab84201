"""The region of the image in which the OpenGL renderers apply the pixel filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fourd.scene.player import Player
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.image_region import ImageRegion, RegionFinder
from tests.baking.scenes import manifest, random_frame, ring


@pytest.mark.parametrize("points", [1, 70, 3000])
def test_no_disc_is_outside_the_region(points: int, rng: np.random.Generator) -> None:
    """Catches contours that are cut off: a box that misses points, a margin below the radius, and a region of the
    previous frame."""
    described, finder, player = replace(manifest(views=6), pixel_filter=0.25), RegionFinder(), Player()
    for _ in range(3):
        frame = random_frame(points, 6, seed=int(rng.integers(1 << 30)))
        for camera in ring(3):
            far = replace(camera, translation=camera.translation + np.array([0.3, -0.2, 4.0])).resize(160, 96)
            request = RenderRequest(frame, far, described, DisplaySettings(12))
            depths = (frame.xyz @ far.rotation.T + far.translation)[:, 2]
            margin = int(np.ceil(far.intrinsics[1, 1] * float(frame.radius.max()) / depths.min())) + 1
            region = finder.find(request, margin)
            drawn = player.draw(frame, far, described).any(axis=2)
            outside = drawn.copy()
            outside[region.top : region.bottom, region.left : region.right] = False
            assert not outside.any()
            assert (region.right - region.left) * (region.bottom - region.top) < drawn.size


def test_the_region_is_the_whole_image_if_points_can_be_behind_the_camera() -> None:
    """Catches corners behind the camera, whose projections are on the wrong side of the image."""
    frame, described, camera = random_frame(500, 6, seed=1), manifest(views=6), ring(3)[0]
    inside = replace(camera, translation=-camera.rotation @ frame.xyz.mean(axis=0))
    for seen, margin in ((inside, 3), (camera, None)):
        request = RenderRequest(frame, seen, described, DisplaySettings(12))
        assert RegionFinder().find(request, margin) == ImageRegion(0, 0, seen.width, seen.height)
