"""The rasterizer in plain torch: slow, but simple, and differentiable through autograd."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.rendering.ops.meshes.ids import decode_ids, encode_ids
from fourd.rendering.ops.rasterize.coverage import Pieces, covered, cut_triangles

_LARGEST_COEFFICIENT = 1e10
_SMALLEST_INVERSE_W = 1e-6
_PIECES_AT_ONCE = 512


@dataclass(frozen=True)
class Planes:
    """Linear functions over the image, one row for each triangle.

    Attributes:
        b: (T, 3, 3) linear function ``weight / w * m`` for each vertex. Both ``weight`` and ``w`` depend on the pixel:
            ``weight`` is the vertex's perspective-correct barycentric coordinate, and ``w`` is the clip coordinate w of
            the triangle, interpolated at the pixel. ``m`` is the largest |w| of the triangle's vertices. The last axis
            contains the value at the reference pixel, and the slopes per pixel along x and y.
        depth: (T, 3) linear function z/w, as its value at the reference pixel and its slopes per pixel along x and y.
        low, high: (T,) smallest and largest z/w of the vertices, to which the depth is clamped.
        reference: (T, 2) column and row of the reference pixel, which is the origin of the linear functions.
        is_valid: (T,) true if the triangle is not degenerate.
    """

    b: Tensor
    depth: Tensor
    low: Tensor
    high: Tensor
    reference: Tensor
    is_valid: Tensor


def rasterize_triangles_reference(
    pos: Tensor,
    tri: Tensor,
    ranges: Tensor | None,
    previous: Tensor | None,
    height: int,
    width: int,
    output_db: bool,
    grad_db: bool,
) -> tuple[Tensor, Tensor]:
    """Compute the result of :func:`fourd.rendering.ops.rasterize.op.rasterize_triangles`, for pos of float32 or
    float64.

    Memory is proportional to the number of triangles times the number of pixels.
    """
    images = []
    for image in range(pos.shape[0] if ranges is None else ranges.shape[0]):
        vertices = pos[0 if ranges is not None else image]
        first, count = (0, tri.shape[0]) if ranges is None else (int(value) for value in ranges[image])
        chosen = tri[first : first + count]
        images.append(_rasterize_image(vertices, chosen, first, None if previous is None else previous[image],
                                       (height, width)))  # fmt: skip
    if not images:
        return pos.new_zeros(0, height, width, 4), pos.new_zeros(0, height, width, 4 if output_db else 0)
    rast, rast_db = (torch.stack(values) for values in zip(*images, strict=True))
    if not output_db:
        return rast, rast_db[..., :0]
    return rast, rast_db if grad_db else rast_db.detach()


def _rasterize_image(
    pos: Tensor, tri: Tensor, first: int, previous: Tensor | None, size: tuple[int, int]
) -> tuple[Tensor, Tensor]:
    tri = tri.cpu()
    pieces = cut_triangles(pos.float(), tri, first, *size)
    planes = make_planes(pos.cpu(), tri[pieces.triangle - first].long(), pieces.reference, size)
    winner, depth = _nearest(pieces, planes, None if previous is None else previous.detach().cpu(), size)
    hit = winner >= 0
    if not bool(hit.any()):
        return pos.new_zeros(*size, 4), pos.new_zeros(*size, 4)
    row, column = hit.nonzero(as_tuple=True)
    at = winner[hit]
    dx, dy = _distances(planes.reference[at], column, row, pos.dtype)
    b = planes.b[at]
    value = (b[:, :, 0] + b[:, :, 2] * dy[:, None]) + b[:, :, 1] * dx[:, None]
    w = 1 / value.sum(1).clamp(min=_SMALLEST_INVERSE_W)
    u = (value[:, 0] * w).clamp(0, 1)
    v = torch.minimum((value[:, 1] * w).clamp(min=0), 1 - u)
    slopes = [(b[:, k, axis] - weight * b[:, :, axis].sum(1)) * w for k, weight in ((0, u), (1, v)) for axis in (1, 2)]
    id_value = encode_ids(pieces.triangle[at]).to(pos.dtype)
    rast, rast_db = torch.zeros(*size, 4, dtype=pos.dtype), torch.zeros(*size, 4, dtype=pos.dtype)
    rast = rast.index_put((row, column), torch.stack([u, v, depth[hit], id_value], 1))
    rast_db = rast_db.index_put((row, column), torch.stack(slopes, 1))
    return rast.to(pos.device), rast_db.to(pos.device)


def make_planes(pos: Tensor, corners: Tensor, reference: Tensor, size: tuple[int, int]) -> Planes:
    """Compute the linear functions of triangles in float64, and round them to the dtype of ``pos``.

    Let M be the matrix whose columns are (x, y, w) of the vertices, and let f be a pixel centre in normalised device
    coordinates. Element k of M^-1 @ (f_x, f_y, 1) is vertex k's perspective-correct barycentric coordinate at f,
    divided by w at f (Olano and Greer 1997).

    Args:
        pos: (V, 4) clip coordinates.
        corners: (T, 3) vertex indices.
        reference: (T, 2) column and row of the reference pixels.
        size: height and width of the image in pixels.
    """
    height, width = size
    points = pos.double()[corners]
    xyw, z = points[:, :, [0, 1, 3]], points[:, :, 2].detach()
    normals = torch.stack([_cross(xyw[:, (k + 1) % 3], xyw[:, (k + 2) % 3]) for k in range(3)], 1)
    scale = xyw[:, :, 2].detach().abs().amax(1)
    inverse = scale / _dot(xyw[:, 0], normals[:, 0])
    at = (2 * reference + 1) / torch.tensor([width, height], dtype=torch.float64) - 1
    value = _dot(normals, torch.cat([at, torch.ones_like(at[:, :1])], 1)[:, None]) * inverse[:, None]
    slope_x = normals[:, :, 0] * inverse[:, None] * (2.0 / width)
    slope_y = normals[:, :, 1] * inverse[:, None] * (2.0 / height)
    b = torch.stack([value, slope_x, slope_y], 2)
    depth = _dot(z[:, None], b.detach().transpose(1, 2)) / scale[:, None]
    sums = b.detach()[:, 0] + b.detach()[:, 1] + b.detach()[:, 2]
    largest = torch.cat([b.detach()[:, :2].flatten(1), sums, depth], 1).abs()
    is_valid = (largest <= _LARGEST_COEFFICIENT).all(1)
    ratio = pos.detach()[corners][:, :, 2] / pos.detach()[corners][:, :, 3]
    in_front = (xyw[:, :, 2] > 0).all(1)
    limit = torch.finfo(torch.float32).max
    low, high = ratio.amin(1).where(in_front, -limit), ratio.amax(1).where(in_front, limit)
    return Planes(b.to(pos.dtype), depth.to(pos.dtype), low, high, reference, is_valid)


def _nearest(pieces: Pieces, planes: Planes, previous: Tensor | None, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Return the index (H, W) and the depth (H, W) of the piece (part of a triangle after clipping) that is nearest to
    the camera at each pixel. If ``previous`` is given, only pieces behind this depth layer are considered. The index is
    -1 where there is no piece."""
    height, width = size
    best = torch.full(size, -1, dtype=torch.int64)
    best_depth = torch.full(size, torch.inf, dtype=planes.depth.dtype)
    column, row = torch.arange(width)[None, :], torch.arange(height)[:, None]
    for begin in range(0, len(pieces.triangle), _PIECES_AT_ONCE):
        part = slice(begin, begin + _PIECES_AT_ONCE)
        chunk = Pieces(pieces.corners[part], pieces.triangle[part], pieces.reference[part])
        inside = covered(chunk, height, width) & planes.is_valid[part, None, None]
        for offset in range(len(chunk.triangle)):
            index = begin + offset
            dx, dy = _distances(planes.reference[index], column, row, planes.depth.dtype)
            c, x, y = planes.depth[index]
            depth = ((c + y * dy) + x * dx).clamp(planes.low[index], planes.high[index])
            hit = inside[offset] & (depth >= -1) & (depth <= 1) & (depth < best_depth)
            if previous is not None:
                hit &= _is_behind(depth, int(pieces.triangle[index]), previous)
            best[hit], best_depth[hit] = index, depth[hit]
    return best, best_depth


def _is_behind(depth: Tensor, triangle: int, previous: Tensor) -> Tensor:
    """Return a mask of the pixels at which a triangle comes after the triangle of the previous layer. Triangles are
    ordered by depth, and by index at equal depth.

    The mask is False where the previous layer shows the background.
    """
    before, before_id = previous[..., 2], decode_ids(previous[..., 3])
    is_after = (depth > before) | ((depth == before) & (triangle > before_id))
    return is_after & (before_id >= 0)


def _distances(reference: Tensor, column: Tensor, row: Tensor, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    return (column - reference[..., 0]).to(dtype), (row - reference[..., 1]).to(dtype)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    """Return the cross product, computed with the kernels' order of operations."""
    return torch.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        -1,
    )


def _dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the dot product over the last axis, summed from the first element to the last."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
