"""Colours of surface points, blended from the source views that see each point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.carving.silhouette import sample
from fourd.mesh.views import MeshView

Floats = NDArray[np.float32]

ANGLE_POWER = 6
"""Power p of the cosine between normal and direction to the camera in the weight of a view. With a high power, textures
are sharp, because few views are mixed. With a low power, differences between the views are less visible than with a
high power."""

MIN_COSINE = 0.1
"""Minimum cosine at which a view colours a point. Below this minimum, the point is seen at a grazing angle."""

DEPTH_TOLERANCE_PX = 2.0
"""A point is visible if it is at most this distance, in pixels, behind the rasterized depth. The size of a pixel at the
point's depth converts this distance to world units. The size is divided by the cosine, because the depth changes by
more from pixel to pixel on slanted surfaces than on surfaces that face the camera."""

CHUNK = 1 << 19
"""Number of points that are coloured in one block. The block size limits the memory for large textures."""


@dataclass(frozen=True, eq=False)
class SourceView:
    """A view together with the depth of the mesh in this view.

    Attributes:
        view: camera, image and matte.
        depth: (H, W) float32 depth of the mesh in world units. The depth is infinite where the view shows no mesh.
    """

    view: MeshView
    depth: Floats


def blend_views(xyz: Floats, normals: Floats, sources: Sequence[SourceView]) -> tuple[Floats, Floats]:
    """Blend the colours of points from the views that see the points.

    The weight of a view is cos^p m^2. Here, cos is the cosine between the normal and the direction to the camera, and p
    is ANGLE_POWER. The factor m is the smallest matte value of the 3 x 3 pixels around the point. Therefore, pixels at
    the contour, which mix subject and background, have little weight. The weight is 0 if the point lies behind the
    smallest mesh depth of the 3 x 3 pixels. Therefore, near the contour of a front part of the mesh, the colours of
    this part are not painted on the part behind it.

    Args:
        xyz: (P, 3) points on the mesh.
        normals: (P, 3) outward unit normals.
        sources: the views, with depth images of the same mesh.

    Returns:
        rgb: (P, 3) float32 colours in [0, 1]. The colour is 0 where no view sees the point.
        weight: (P,) float32 sum of the views' weights. The sum is 0 where no view sees the point.
    """
    rgb, weight = np.zeros((len(xyz), 3), np.float32), np.zeros(len(xyz), np.float32)
    prepared = [_prepare(source) for source in sources]
    for begin in range(0, len(xyz), CHUNK):
        part = slice(begin, begin + CHUNK)
        for source, nearest, matte in prepared:
            _add_view(source, nearest, matte, xyz[part], normals[part], rgb[part], weight[part])
    seen = weight > 0
    rgb[seen] /= weight[seen, None]
    return rgb, weight


def _prepare(source: SourceView) -> tuple[SourceView, Floats, Floats]:
    """The view, with the smallest depth and the smallest matte value of the 3 x 3 pixels around each pixel."""
    square = np.ones((3, 3), np.uint8)
    nearest = np.asarray(cv2.erode(source.depth, square, borderType=cv2.BORDER_REPLICATE), np.float32)
    matte = np.asarray(cv2.erode(source.view.matte, square, borderType=cv2.BORDER_REPLICATE), np.float32)
    return source, nearest, matte


def _add_view(
    source: SourceView, nearest: Floats, matte: Floats, xyz: Floats, normals: Floats, rgb: Floats, weight: Floats
) -> None:
    """Add the weighted colours of one view to ``rgb`` (P, 3) and the weights to ``weight`` (P,), in place."""
    camera = source.view.camera
    rays = camera.centre.astype(np.float32) - xyz
    cosine = (rays * normals).sum(axis=1) / np.maximum(np.linalg.norm(rays, axis=1), np.float32(1e-12))
    pixels, depth = camera.project(xyz)
    pixels, depth = pixels.astype(np.float32), depth.astype(np.float32)
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0).all(axis=1) & (pixels < (camera.width, camera.height)).all(axis=1) & (depth > 0)
    seen = np.flatnonzero((cosine > MIN_COSINE) & inside)
    if len(seen) == 0:
        return
    x, y = np.ascontiguousarray(pixels[seen].T)
    tolerance = DEPTH_TOLERANCE_PX * depth[seen] / np.float32(camera.intrinsics[1, 1]) / cosine[seen]
    visible = depth[seen] <= nearest[y.astype(np.intp), x.astype(np.intp)] + tolerance
    seen, x, y = seen[visible], x[visible], y[visible]
    share = cosine[seen] ** ANGLE_POWER * sample(matte, x, y, cv2.INTER_LINEAR) ** 2
    rgb[seen] += share[:, None] * sample(source.view.rgb, x, y, cv2.INTER_LINEAR)
    weight[seen] += share
