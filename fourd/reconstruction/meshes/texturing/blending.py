"""Colours of surface points, blended from the source views that see each point."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.reconstruction.carving.silhouette import sample
from fourd.reconstruction.meshes.texturing.visibility import Occluder
from fourd.reconstruction.meshes.views import MeshView

Floats = NDArray[np.float32]

ANGLE_POWER = 6
"""The weight of a view is proportional to the cosine between the normal and the direction to the camera, raised to this
power. A high power gives sharp textures, because few views are mixed. A low power makes colour differences between the
views less visible."""

MIN_COSINE = 0.1
"""A view does not colour a point if the cosine between the normal and the direction to the camera is at most this
value, because the view sees the point at a grazing angle."""

CHUNK = 1 << 19
"""Number of points that are coloured at once, which limits the memory for large textures."""


def blend_views(xyz: Floats, normals: Floats, views: Sequence[MeshView], occluder: Occluder) -> tuple[Floats, Floats]:
    """Blend the colours of points from the views that see the points.

    The weight of a view is cos^p * m^2, where cos is the cosine between the normal and the direction to the camera, p
    is ANGLE_POWER, and m is the smallest matte value of the 3 x 3 pixels around the point. The factor m^2 gives little
    weight to pixels at the contour, where subject and background mix. The weight is 0 if the mesh hides the point from
    the camera (:class:`fourd.reconstruction.meshes.texturing.visibility.Occluder`).

    Args:
        xyz: (P, 3) points on the mesh.
        normals: (P, 3) outward unit normals.
        views: the views.
        occluder: the mesh.

    Returns:
        rgb: (P, 3) float32 colours in [0, 1], 0 where no view sees the point.
        weight: (P,) float32 sum of the views' weights, 0 where no view sees the point.
    """
    rgb, weight = np.zeros((len(xyz), 3), np.float32), np.zeros(len(xyz), np.float32)
    square = np.ones((3, 3), np.uint8)
    mattes = [np.asarray(cv2.erode(view.matte, square, borderType=cv2.BORDER_REPLICATE), np.float32) for view in views]
    for begin in range(0, len(xyz), CHUNK):
        part = slice(begin, begin + CHUNK)
        for view, matte in zip(views, mattes, strict=True):
            _add_view(view, matte, occluder, xyz[part], normals[part], rgb[part], weight[part])
    seen = weight > 0
    rgb[seen] /= weight[seen, None]
    return rgb, weight


def _add_view(
    view: MeshView, matte: Floats, occluder: Occluder, xyz: Floats, normals: Floats, rgb: Floats, weight: Floats
) -> None:
    """Add one view's weighted colours to ``rgb`` (P, 3) and its weights to ``weight`` (P,), in place."""
    camera = view.camera
    rays = camera.centre.astype(np.float32) - xyz
    cosine = (rays * normals).sum(axis=1) / np.maximum(np.linalg.norm(rays, axis=1), np.float32(1e-12))
    pixels, depth = camera.project(xyz)
    pixels = pixels.astype(np.float32)
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0).all(axis=1) & (pixels < (camera.width, camera.height)).all(axis=1) & (depth > 0)
    seen = np.flatnonzero((cosine > MIN_COSINE) & inside)
    if len(seen) == 0:
        return
    x, y = np.ascontiguousarray(pixels[seen].T)
    share = cosine[seen] ** ANGLE_POWER * sample(matte, x, y, cv2.INTER_LINEAR) ** 2
    visible = share > 0
    visible[visible] = ~occluder.hides(xyz[seen[visible]], normals[seen[visible]], camera)
    seen, x, y, share = seen[visible], x[visible], y[visible], share[visible]
    rgb[seen] += share[:, None] * sample(view.rgb, x, y, cv2.INTER_LINEAR)
    weight[seen] += share
