"""Tests which pixels are covered by triangles. The expected pixels are computed with exact integer arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.meshes.ids import decode_ids
from fourd.rendering.triangles import rasterize
from tests.raster.triangles.scenes import each_alone, grid, with_w

BACKENDS = ["cpu", "reference"]


def exact_coverage(corners: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return which pixel centres are inside a triangle of integer vertices (3, 2), in units of 1/256 pixel.

    The centres are moved by (epsilon, epsilon^2), so that no inclusion rule for edges is needed. Python's integers do
    not overflow.
    """
    (ax, ay), (bx, by), (cx, cy) = (tuple(int(value) for value in corner) for corner in corners)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    out = np.zeros((height, width), bool)
    if area == 0:
        return out
    edges = [((ax, ay), (bx, by)), ((bx, by), (cx, cy)), ((cx, cy), (ax, ay))]
    sign = 1 if area > 0 else -1
    for row in range(height):
        for column in range(width):
            x, y = 256 * column + 128, 256 * row + 128
            keys = []
            for (fx, fy), (tx, ty) in edges:
                value = (tx - fx) * (y - fy) - (ty - fy) * (x - fx)
                keys.append((sign * value, sign * (fy - ty), sign * (tx - fx)))
            out[row, column] = all(key > (0, 0, 0) for key in keys)
    return out


def positions_of(corners: np.ndarray, height: int, width: int) -> Tensor:
    """Return clip coordinates whose rounded vertices are ``corners`` (V, 2)."""
    xy = corners / 128.0 / np.array([width, height]) - 1
    return with_w(torch.from_numpy(xy.astype(np.float32)))


@pytest.mark.parametrize("backend", BACKENDS)
def test_coverage_equals_exact_arithmetic(backend: str, rng: np.random.Generator) -> None:
    """Catches edge functions that overflow or are rounded, and centres on edges that belong to no triangle or to both
    sides. Half of the vertices are at pixel centres, so that many centres are on edges and vertices."""
    height, width, count = 8, 16, 60
    corners = rng.integers(-256 * 40, 256 * 60, (count, 3, 2))
    near = rng.random((count, 3, 1)) < 0.6
    corners = np.where(near, 256 * rng.integers(-2, 17, (count, 3, 2)) + 128, corners)
    tri = torch.arange(3 * count, dtype=torch.int32).reshape(-1, 3)
    pos = positions_of(corners.reshape(-1, 2), height, width)
    rast, _ = rasterize(pos, tri, (height, width), ranges=each_alone(tri), backend=backend)
    expected = np.stack([exact_coverage(triangle, height, width) for triangle in corners])
    assert expected.any()
    np.testing.assert_array_equal(rast[..., 3].numpy() > 0, expected)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("size", [(64, 64), (37, 53)])
def test_shared_edges_are_covered_once(backend: str, size: tuple[int, int], rng: np.random.Generator) -> None:
    """Catches gaps and double coverage between neighbours, for any order of triangles and vertices. The vertices of the
    second mesh are at pixel centres."""
    for jitter in (0.24, 0.0):
        xy, tri = grid(rng, 6, jitter)
        if jitter == 0.0:
            half = torch.tensor([size[1], size[0]]) / 2
            xy = ((xy * half + half).round() + 0.5 - half) / half
        rast, _ = rasterize(with_w(xy), tri, size, ranges=each_alone(tri), backend=backend)
        times = (rast[..., 3] > 0).sum(0)
        assert torch.equal(times, torch.ones_like(times))


@pytest.mark.parametrize("backend", BACKENDS)
def test_shared_edges_behind_the_camera_are_covered_once(backend: str, rng: np.random.Generator) -> None:
    """Catches adjacent triangles that are clipped differently. A plane extends below and behind the camera. Every pixel
    below the horizon must be covered once, and no pixel above the horizon may be covered.
    """
    xy, tri = grid(rng, 8)
    ground = 40 * xy
    pos = torch.stack([ground[:, 0], torch.ones(len(xy)), 0.5 * ground[:, 1], ground[:, 1]], 1)
    height, width = 60, 80
    rast, _ = rasterize(pos, tri, (height, width), ranges=each_alone(tri), backend=backend)
    times = (rast[..., 3] > 0).sum(0)
    y = (2 * torch.arange(height) + 1) / height - 1
    in_mesh = (y > 0) & (1 / y < 40 * 1.19)
    assert torch.equal(times[in_mesh], torch.ones_like(times[in_mesh]))
    assert int(times[y < 0].sum()) == 0
    # At the pixel (x, y), the plane has w = 1 / y. The interpolated w must have this value.
    whole, _ = rasterize(pos[None], tri, (height, width), backend=backend)
    hit = decode_ids(whole[0, ..., 3]).long()
    w = pos[tri.long()[hit.clamp(min=0)]][..., 3]
    weights = torch.cat([whole[0, ..., :2], 1 - whole[0, ..., :2].sum(-1, keepdim=True)], -1)
    found = 1 / (weights * w).sum(-1)
    torch.testing.assert_close(found[in_mesh], y[in_mesh][:, None].expand(-1, width), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("backend", BACKENDS)
def test_only_depths_between_the_planes_are_visible(backend: str) -> None:
    """Catches clipping at the wrong sign of z, and depths that are interpolated with perspective twice. The depth z/w
    grows from -2 at the left to 2 at the right."""
    pos = torch.tensor([[[-1.0, -1, -2, 1], [1, -1, 2, 1], [-1, 1, -2, 1], [1, 1, 2, 1]]])
    pos = pos * torch.tensor([1.0, 2.0, 1.0, 2.0])[None, :, None]
    tri = torch.tensor([[0, 1, 2], [1, 3, 2]], dtype=torch.int32)
    rast, _ = rasterize(pos, tri, (8, 64), backend=backend)
    x = (2 * torch.arange(64) + 1) / 64 - 1
    assert torch.equal(rast[0, ..., 3] > 0, (x.abs() <= 0.5).expand(8, 64))
    torch.testing.assert_close(rast[0, 3, 16:48, 2], 2 * x[16:48])


@pytest.mark.parametrize("backend", BACKENDS)
def test_equal_depths_go_to_the_smaller_index(backend: str) -> None:
    """Catches results at equal depths that depend on the order in which triangles are processed."""
    pos = with_w(torch.tensor([[-1.0, -1], [3, -1], [-1, 3]]))[None]
    tri = torch.tensor([[0, 1, 2]] * 5, dtype=torch.int32)
    for first in range(5):
        ranges = torch.tensor([[first, 5 - first]], dtype=torch.int32)
        rast, _ = rasterize(pos[0], tri, (40, 40), ranges=ranges, backend=backend)
        assert torch.equal(rast[..., 3], torch.full_like(rast[..., 3], first + 1))


def test_large_images_and_far_vertices(rng: np.random.Generator) -> None:
    """Catches overflow of pixel coordinates in images of the largest width, and holes where an edge leaves the guard
    band."""
    pos = with_w(torch.tensor([[-1.0, -1], [1, -1], [-1, 1], [1, 1]]))
    pos[:, :2] *= torch.from_numpy(10 ** rng.uniform(0, 9, (4, 1)).astype(np.float32))
    tri = torch.tensor([[0, 1, 2], [3, 2, 1]], dtype=torch.int32)
    for size in ((2, 32768), (32768, 2), (64, 64)):
        rast, _ = rasterize(pos, tri, size, ranges=each_alone(tri))
        times = (rast[..., 3] > 0).sum(0)
        # The diagonal from vertex 1 to vertex 2 can leave the image on one side, but never shows a gap or an overlap.
        assert int(times.max()) <= 1
        assert float(times.float().mean()) > 0.4
