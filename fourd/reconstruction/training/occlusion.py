"""Render depth maps of points, to test whether a point is occluded in a source view."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
import torch
from scipy.ndimage import maximum_filter
from torch import Tensor
from torch.nn import functional

from fourd.base.cameras import Camera
from fourd.reconstruction.model.sources import SourceViews
from fourd.rendering import render_points
from fourd.rendering.ops.loading import as_array
from fourd.rendering.ops.points.arrays import render_points_numpy

SURFACE_LAYERS = 4
MAX_DILATION_PX = 16


class SizedPoints(Protocol):
    """N points with positions (N, 3) and radii (N,) in world units, and densities (N,)."""

    @property
    def xyz(self) -> Tensor: ...
    @property
    def radius(self) -> Tensor: ...
    @property
    def density(self) -> Tensor: ...


def surface_depth(points: SizedPoints, camera: Camera, near: float, threads: int = 0) -> Tensor:
    """Render the depth (H, W) of the nearest surface beyond the near plane, in world units. It is infinite where
    alpha is at most 0.5. ``threads`` is the number of CPU threads, or 0 for the default."""
    if points.xyz.device.type == "cpu":
        # NumPy is faster here: after a torch operation, torch's threads busy-wait for the next one and slow down the
        # renderer's threads.
        ones = np.ones((points.xyz.shape[0], 1), np.float32)
        arrays = (as_array(points.xyz), ones, as_array(points.radius), as_array(points.density))
        _, alpha, depth = render_points_numpy(*arrays, camera, layers=SURFACE_LAYERS, near=near, threads=threads)
        np.copyto(depth, np.float32(np.inf), where=~(alpha > 0.5))
        return torch.from_numpy(depth)
    colour = torch.ones_like(points.radius)[:, None]
    with torch.no_grad():
        render = render_points(
            points.xyz, colour, points.radius, points.density, camera, layers=SURFACE_LAYERS, near=near
        )
    return torch.where(render.alpha > 0.5, render.depth, torch.inf)


def occlusion_depth(points: SizedPoints, camera: Camera, near: float) -> Tensor:
    """Compute the depth (H, W) behind which points are occluded: the surface depth, dilated by the typical point size.

    Dilation is needed because the surface depth is rendered from discs that face the camera: on a floor viewed at a
    grazing angle, each disc covers the discs behind it. Without dilation, half of the floor's visible points would be
    treated as occluded. The dilation assigns to each pixel the farthest surface depth within the median disc radius
    around it.
    """
    pixels, depth = camera.project(points.xyz.cpu().double().numpy())
    inside = camera.is_in_image(pixels, depth) & (depth > near)
    surface = surface_depth(points, camera, near)
    if not inside.any():
        return surface
    radius_px = camera.intrinsics[0, 0] * points.radius.cpu().numpy()[inside] / depth[inside]
    reach = min(int(np.ceil(np.median(radius_px))), MAX_DILATION_PX)
    farthest = _maximum_filter(torch.where(torch.isfinite(surface), surface, 0), reach)
    return torch.where(farthest > 0, farthest, torch.inf)


def _maximum_filter(image: Tensor, reach: int) -> Tensor:
    """Return, for each pixel, the maximum of ``image`` (H, W) in a square of side ``2 * reach + 1`` around the
    pixel."""
    if image.device.type == "cpu":
        return torch.from_numpy(maximum_filter(image.numpy(), 2 * reach + 1))
    rows = functional.max_pool2d(image[None], (2 * reach + 1, 1), stride=1, padding=(reach, 0))
    return functional.max_pool2d(rows, (1, 2 * reach + 1), stride=1, padding=(0, reach))[0]


def with_surface_depth(
    sources: SourceViews, points: SizedPoints, occlusion: bool, near: float, threads: int = 0
) -> SourceViews:
    """Add the surface depth of ``points`` to each of the views ``sources``. If ``occlusion`` is false, the views are
    returned unchanged. ``threads`` is the number of CPU threads, or 0 for the default."""
    if not occlusion:
        return sources
    depths = [surface_depth(points, camera, near, threads) for camera in sources.cameras]
    if depths[0].device.type == "cpu":
        return replace(sources, depth=torch.from_numpy(np.stack([as_array(depth) for depth in depths])))
    return replace(sources, depth=torch.stack(depths))
