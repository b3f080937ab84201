"""Computes which pixels each triangle covers in the reference rasterizer.

Triangles are clipped, their vertices are rounded to 1/256 pixel, and their edge functions are evaluated exactly.

The functions compute the same numbers as their counterparts in the kernels (``csrc/rasterize/maths.h`` and
``csrc/rasterize/clipping.h``), and are not differentiable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

SUBPIXELS = 256
_MAX_EXTENT_PX = 2**17

Corner = tuple[float, float, float]
"""Coordinates x, y and w of a vertex."""


@dataclass(frozen=True)
class Pieces:
    """Pieces of triangles after clipping. Each piece is a triangle with positive area and integer vertices. A triangle
    that is not clipped has at most one piece; a clipped one can have several.

    Attributes:
        corners: (P, 3, 2) int64 x and y of the vertices, in units of 1/256 pixel.
        triangle: (P,) int64 index of the triangle that each piece belongs to, in ascending order.
        reference: (P, 2) int64 column and row of the reference pixel, which is the origin of the linear functions in
            :class:`fourd.rendering.ops.rasterize.reference.Planes`.
    """

    corners: Tensor
    triangle: Tensor
    reference: Tensor


def cut_triangles(pos: Tensor, tri: Tensor, first: int, height: int, width: int) -> Pieces:
    """Clip the triangles of an image, round their vertices to 1/256 pixel, and drop the pieces that cover no pixel.

    Args:
        pos: (V, 4) float32 clip coordinates.
        tri: (T, 3) vertex indices.
        first: index that the first triangle of ``tri`` has in the whole mesh.
        height, width: size of the image in pixels.
    """
    corners, triangles, references = [], [], []
    positions = pos.detach().cpu().numpy()
    for index, vertices in enumerate(tri.tolist()):
        points = positions[vertices]
        if not np.isfinite(points).all():
            continue
        polygon, is_clipped = _polygon(points, width, height)
        for i in range(1, len(polygon) - 1):
            piece = [polygon[0], polygon[i], polygon[i + 1]]
            bounds = _bounds(piece, width, height)
            if (area := _area(piece)) == 0 or bounds is None:
                continue
            corners.append(piece if area > 0 else [piece[0], piece[2], piece[1]])
            triangles.append(first + index)
            references.append([width // 2, height // 2] if is_clipped else bounds)
    return Pieces(
        torch.tensor(corners, dtype=torch.int64).reshape(-1, 3, 2),
        torch.tensor(triangles, dtype=torch.int64),
        torch.tensor(references, dtype=torch.int64).reshape(-1, 2),
    )


def covered(pieces: Pieces, height: int, width: int) -> Tensor:
    """Return a mask (P, H, W) that is true where a piece covers a pixel. A pixel centre on an edge is covered only if
    the edge is a left or top edge of the piece."""
    x = SUBPIXELS * torch.arange(width) + SUBPIXELS // 2
    y = SUBPIXELS * torch.arange(height) + SUBPIXELS // 2
    inside = torch.ones(len(pieces.triangle), height, width, dtype=torch.bool)
    for k in range(3):
        here, after = pieces.corners[:, k, :, None, None], pieces.corners[:, (k + 1) % 3, :, None, None]
        slope_x, slope_y = here[:, 1] - after[:, 1], after[:, 0] - here[:, 0]
        value = slope_x * (x[None, None, :] - here[:, 0]) + slope_y * (y[None, :, None] - here[:, 1])
        includes_centres = (slope_x > 0) | ((slope_x == 0) & (slope_y > 0))
        inside &= (value > 0) | ((value == 0) & includes_centres)
    return inside


def _polygon(points: NDArray[np.float32], width: int, height: int) -> tuple[list[list[int]], bool]:
    """Clip a triangle at the guard band, a rectangle that contains the image and is at least 4 times as wide and as
    high. Return the rounded corners of the clipped polygon, and a bool that is true if the triangle was clipped."""
    guard_x, guard_y = _guard(width), _guard(height)
    x, y, w = (points[:, axis].astype(np.float64) for axis in (0, 1, 3))
    is_inside = (w > 0) & (np.abs(x) <= guard_x * w) & (np.abs(y) <= guard_y * w)
    corners = [(float(x[k]), float(y[k]), float(w[k])) for k in range(3)]
    if not is_inside.all():
        for axis, sign, guard in ((0, 1, guard_x), (0, -1, guard_x), (1, 1, guard_y), (1, -1, guard_y)):
            corners = _clip(corners, axis, sign, guard)
    snapped = [_snap(corner, guard_x, guard_y, width, height) for corner in corners]
    return snapped, not bool(is_inside.all())


def _guard(side: int) -> int:
    """Return the ratio of the guard band's side length to the image's side length ``side``, which is in pixels. The
    ratio is a power of two.

    The guard band is the rectangle around the image at which triangles are clipped. It extends at most 2^16 pixels from
    the image's centre.
    """
    guard = 4
    while 2 * guard * side <= _MAX_EXTENT_PX:
        guard *= 2
    return guard


def _clip(corners: list[Corner], axis: int, sign: int, guard: int) -> list[Corner]:
    """Cut off the part of a polygon where ``guard * w + sign * corner[axis]`` is negative (Sutherland and Hodgman
    1974)."""
    out: list[Corner] = []
    distance = [guard * corner[2] + sign * corner[axis] for corner in corners]
    for i, here in enumerate(corners):
        j = (i + 1) % len(corners)
        if distance[i] >= 0:
            out.append(here)
        if (distance[i] >= 0) != (distance[j] >= 0):
            inside, outside = (i, j) if distance[i] >= 0 else (j, i)
            t = distance[inside] / (distance[inside] - distance[outside])
            from_, to = corners[inside], corners[outside]
            x, y, w = (a + t * (b - a) for a, b in zip(from_, to, strict=True))
            out.append((x, y, w))
    return out


def _snap(corner: Corner, guard_x: int, guard_y: int, width: int, height: int) -> list[int]:
    x, y, w = (np.float32(value) for value in corner)
    if not w > 0:
        x, y, w = np.float32(0), np.float32(0), np.float32(1)
    snapped = []
    for value, guard, side in ((x, guard_x, width), (y, guard_y, height)):
        limit = np.float32(guard) * w
        half = SUBPIXELS // 2 * side
        ratio = np.clip(value, -limit, limit) / w * np.float32(half)
        snapped.append(int(np.floor(np.float64(ratio) + 0.5)) + half)
    return snapped


def _area(piece: list[list[int]]) -> int:
    (ax, ay), (bx, by), (cx, cy) = piece
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _bounds(piece: list[list[int]], width: int, height: int) -> list[int] | None:
    """Return the column and row of the first pixel of the image whose centre is in the piece's bounding box, or None if
    the box contains no pixel centre of the image."""
    first = []
    for axis, side in ((0, width), (1, height)):
        values = [corner[axis] for corner in piece]
        low = max((min(values) + SUBPIXELS // 2 - 1) // SUBPIXELS, 0)
        high = min((max(values) - SUBPIXELS // 2) // SUBPIXELS, side - 1)
        if low > high:
            return None
        first.append(low)
    return first
