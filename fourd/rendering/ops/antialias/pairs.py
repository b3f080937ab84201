"""Finds neighbouring pixels that show different triangles, and the silhouette edges between them, in plain torch."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.rendering.ops.meshes.ids import decode_ids

TOLERANCE_PX = 0.0625
EDGES = ((1, 2), (2, 0), (0, 1))


@dataclass(frozen=True)
class Pairs:
    """Pairs of neighbouring pixels along one axis. A pair's owner is the pixel whose triangle is nearer.

    Attributes:
        image: (N,) index of the pair's image in the batch.
        owner, other: (N,) indices of the two pixels in the flattened (batch, height, width) array.
        triangle: (N,) index of the triangle that the owner shows.
        other_triangle: (N,) index of the triangle that the other pixel shows, or -1 for the background.
        centre: (N, 2) centre of the owner in normalised device coordinates. The first coordinate is the one along the
            pair's axis, and the second is the one across it: (x, y) for axis 0, and (y, x) for axis 1.
        step: (N, 2) distances between neighbouring pixel centres in normalised device coordinates, first along the
            pair's axis, then across it. The first distance is negative if the other pixel is left of or above the
            owner.
        axis: 0 for right neighbours, 1 for lower neighbours.
    """

    image: Tensor
    owner: Tensor
    other: Tensor
    triangle: Tensor
    other_triangle: Tensor
    centre: Tensor
    step: Tensor
    axis: int

    def __getitem__(self, chosen: Tensor) -> Pairs:
        return Pairs(
            image=self.image[chosen],
            owner=self.owner[chosen],
            other=self.other[chosen],
            triangle=self.triangle[chosen],
            other_triangle=self.other_triangle[chosen],
            centre=self.centre[chosen],
            step=self.step[chosen],
            axis=self.axis,
        )


def find_pairs(rast: Tensor, triangles: int, axis: int) -> Pairs:
    """Find the pairs of neighbouring pixels along ``axis`` that show different triangles."""
    batch, height, width, _ = rast.shape
    ids = decode_ids(rast[..., 3]).long()
    ids = torch.where(ids < triangles, ids, -1).reshape(-1)
    depth = rast.detach()[..., 2].reshape(-1)
    index = torch.arange(batch * height * width, device=rast.device).reshape(batch, height, width)
    first = (index[:, :, :-1] if axis == 0 else index[:, :-1]).reshape(-1)
    first = first[ids[first] != ids[first + (1 if axis == 0 else width)]]
    second = first + (1 if axis == 0 else width)
    one, two = ids[first], ids[second]
    nearer = (depth[second] < depth[first]) | ((depth[second] == depth[first]) & (two < one))
    is_second = (two >= 0) & ((one < 0) | nearer)
    owner, other = torch.where(is_second, second, first), torch.where(is_second, first, second)
    row, column = owner // width % height, owner % width
    dtype = rast.dtype
    x, y = (2 * column + 1).to(dtype) / width - 1, (2 * row + 1).to(dtype) / height - 1
    centre = torch.stack((x, y) if axis == 0 else (y, x), 1)
    steps = (2 / width, 2 / height) if axis == 0 else (2 / height, 2 / width)
    step = torch.tensor(steps, dtype=dtype, device=rast.device).repeat(len(owner), 1)
    step[:, 0] = torch.where(is_second, -step[:, 0], step[:, 0])
    return Pairs(owner // (height * width), owner, other, ids[owner], ids[other], centre, step, axis)


def see(pairs: Pairs, clip: Tensor, vertices: Tensor) -> Tensor:
    """For each of N pairs, return three clip coordinates of K vertices, whose indices are ``vertices`` (N, K). The
    result (N, K, 3) contains the coordinate along the pair's axis, the coordinate across this axis, and w.

    The first two coordinates are relative to the centre of the pair's owner (the pixel whose triangle is nearer): both
    are 0 for a vertex that projects to this centre.
    """
    x, y, w = clip[pairs.image[:, None], vertices].unbind(-1)
    along, across = (x, y) if pairs.axis == 0 else (y, x)
    return torch.stack((along - pairs.centre[:, :1] * w, across - pairs.centre[:, 1:] * w, w), -1)


def line_of(pairs: Pairs, p: Tensor, q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """For each pair, return a linear function of the image position that is 0 on the edge from p to q.

    ``p`` and ``q`` (N, 3) are the clip coordinates of the edge's ends, as :func:`see` returns them. The first result
    (N,) is the function's value at the centre of the pair's owner (the pixel whose triangle is nearer). The second (N,)
    is its decrease per pixel from the owner towards the other pixel. The third (N,) is its decrease per pixel
    perpendicular to the pair's axis, in the direction of increasing image coordinates.
    """
    value = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    along = pairs.step[:, 0] * (p[:, 2] * q[:, 1] - p[:, 1] * q[:, 2])
    across = pairs.step[:, 1] * (p[:, 0] * q[:, 2] - p[:, 2] * q[:, 0])
    return value, along, across


def crossed_edge(pairs: Pairs, clip: Tensor, tri: Tensor, opposite: Tensor) -> Tensor:
    """For each pair of pixels, find the silhouette edge of the nearer triangle that crosses the segment between the two
    pixel centres. Return the edge's index in the triangle (0 to 2), or -1 if there is none."""
    seen = see(pairs, clip, tri.long()[pairs.triangle])
    lines = [line_of(pairs, seen[:, one], seen[:, two]) for one, two in EDGES]
    value, along, across = (torch.stack(parts, 1) for parts in zip(*lines, strict=True))
    inside = value[:, 0] + value[:, 1] + value[:, 2]
    sign = torch.where(inside < 0, -1.0, 1.0)[:, None].to(value)
    value, along, across = value * sign, along * sign, across.abs()
    perpendicular = (along >= across) if pairs.axis == 0 else (along > across)
    crossing = value / along
    valid = perpendicular & (along > 0) & (crossing >= -TOLERANCE_PX) & (crossing <= 1 + TOLERANCE_PX)
    # If several edges cross at the same position, the last of them is selected, as in the kernels.
    nearest, edge = torch.where(valid, crossing, torch.inf).flip(1).min(1)
    edge = 2 - edge
    slack = TOLERANCE_PX * (along.abs() + across)
    on_edge = (value - nearest[:, None] * along >= -slack) | torch.nn.functional.one_hot(edge, 3).bool()
    found = valid.any(1) & on_edge.all(1) & _is_silhouette(pairs, clip, tri, opposite, edge)
    return torch.where(found, edge, -1)


def _is_silhouette(pairs: Pairs, clip: Tensor, tri: Tensor, opposite: Tensor, edge: Tensor) -> Tensor:
    """Return a mask of the edges that are silhouettes. An edge is a silhouette if the triangle has no neighbour across
    it, or if that neighbour projects to the same side of the edge as the triangle itself."""
    neighbour = opposite.long()[pairs.triangle, edge]
    neighbour = torch.where(neighbour < clip.shape[1], neighbour, -1)
    corners = tri.long()[pairs.triangle]
    ends = corners.gather(1, torch.tensor(EDGES, device=tri.device)[edge])
    own = corners.gather(1, edge[:, None])[:, 0]
    p, q = clip[pairs.image[:, None], ends].unbind(1)
    one = _side(p, q, clip[pairs.image, own])
    two = _side(p, q, clip[pairs.image, neighbour.clamp(min=0)])
    return (neighbour < 0) | ~(((one > 0) & (two < 0)) | ((one < 0) & (two > 0)))


def _side(p: Tensor, q: Tensor, r: Tensor) -> Tensor:
    """Return the determinants (N,) of the clip coordinates p, q and r, each (N, 3). A determinant's sign tells on which
    side of the edge from p to q the point r lies."""
    e, d = q - p, r - p
    x = e[:, 1] * d[:, 2] - e[:, 2] * d[:, 1]
    y = e[:, 2] * d[:, 0] - e[:, 0] * d[:, 2]
    w = e[:, 0] * d[:, 1] - e[:, 1] * d[:, 0]
    return (p[:, 0] * x + p[:, 1] * y) + p[:, 2] * w


def crossing_of_edge(pairs: Pairs, clip: Tensor, tri: Tensor, edge: Tensor) -> Tensor:
    """For each pair of neighbouring pixels, return the distance (N,), in pixels, from the centre of the owner (the
    pixel whose triangle is nearer) to the point where an edge of this triangle crosses the segment between the two
    pixel centres. The distance is differentiable.

    ``edge`` (N,) contains the index of this edge in the triangle, 0 to 2.
    """
    ends = torch.tensor(EDGES, device=tri.device)[edge]
    seen = see(pairs, clip, tri.long()[pairs.triangle[:, None], ends])
    value, fall, _ = line_of(pairs, seen[:, 0], seen[:, 1])
    return value / fall
