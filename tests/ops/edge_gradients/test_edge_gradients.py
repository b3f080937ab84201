"""Gradients of moving visibility edges, compared with finite differences of images whose coverage is exact."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.raster.triangles import antialias, edge_gradients
from tests.ops.antialias.scenes import RECTANGLE, random_scene, rasterize_brute_force, rectangle

SIDE = 12


def exact_square(x: float, y: float, size: float) -> Tensor:
    """The exact coverage (H, W) of a square whose first corner is at (x, y) pixels."""
    edges = torch.arange(SIDE + 1, dtype=torch.float64)
    columns, rows = ((edges[1:].clamp(max=at + size) - edges[:-1].clamp(min=at)).clamp(min=0) for at in (x, y))
    return rows[:, None] * columns


def gradient_of(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, upstream: Tensor) -> Tensor:
    leaf = pos.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(edge_gradients(color, rast, leaf, tri), leaf, upstream)
    return gradient


@pytest.mark.parametrize("power", [1.0, 2.5])
def test_moving_square_has_the_slope_of_its_exact_image(power: float) -> None:
    """Catches a gradient of wrong sign or size. The edges lie between pixels, so that central differences of the exact
    image are the mean over the two pixels at an edge. ``power`` scales w, which moves nothing."""
    rows, columns = torch.meshgrid(*(torch.arange(SIDE, dtype=torch.float64) + 0.5,) * 2, indexing="ij")
    weights = 0.3 * columns - 0.2 * rows + 0.05 * columns * rows
    x, y, size, step = 3.0, 4.0, 5.0, 1e-4
    # Two pixels at corners show the triangle that does not have the left or the lower edge.
    weights[4, 2:4] = weights[8:10, 7] = 0

    def loss(dx: float, dy: float) -> float:
        return float((weights * exact_square(x + dx, y + dy, size)).sum())

    square = rectangle(x, y, x + size, y + size, SIDE, SIDE)[None]
    pos = power * square
    rast = rasterize_brute_force(square, RECTANGLE, SIDE, SIDE)
    color = (rast[..., 3:] > 0).double()
    gradient = gradient_of(color, rast, pos, RECTANGLE, weights[None, ..., None])
    found = gradient[0, :, :2].sum(0) * power * 2 / SIDE
    slopes = [(loss(step, 0) - loss(-step, 0)) / (2 * step), (loss(0, step) - loss(0, -step)) / (2 * step)]
    torch.testing.assert_close(found, torch.tensor(slopes, dtype=torch.float64), rtol=1e-6, atol=0)


def test_image_is_unchanged_and_its_gradient_is_the_identity(rng: np.random.Generator) -> None:
    """Catches an image that is blended, and gradients of the colours that are moved between pixels."""
    scene = random_scene(rng)
    color = scene.color.clone().requires_grad_()
    out = edge_gradients(color, scene.rast, scene.pos.requires_grad_(), scene.tri)
    assert torch.equal(out, color)
    upstream = torch.randn_like(color)
    assert torch.equal(torch.autograd.grad(out, color, upstream)[0], upstream)


def test_gradient_agrees_with_antialias_where_the_upstream_gradient_is_constant(rng: np.random.Generator) -> None:
    """Catches silhouettes that one of the two operators misses: for equal upstream gradients, both have the same
    slope."""
    scene = random_scene(rng, intersecting=False)
    upstream = torch.ones_like(scene.color)
    leaf = scene.pos.clone().requires_grad_()
    (expected,) = torch.autograd.grad(antialias(scene.color, scene.rast, leaf, scene.tri), leaf, upstream)
    found = gradient_of(scene.color, scene.rast, scene.pos, scene.tri, upstream)
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3 * float(expected.abs().max()))


def test_intersection_of_two_planes_moves_with_their_depth() -> None:
    """Catches intersections that are missed, and a wrong sign of their slope. Two walls cross at x = 5.3 pixels with
    the slopes -a and a in depth, so raising the depth of one wall by dz moves the line by dz / (2 a) pixels."""
    slope = 0.05
    corners = rectangle(-1.0, -1.0, 13.0, 13.0, SIDE, SIDE)
    x_px = (corners[:, 0] + 1) * SIDE / 2
    walls = []
    for sign in (-1, 1):
        wall = corners.clone()
        wall[:, 2] = sign * slope * (x_px - 5.3)
        walls.append(wall)
    pos, tri = torch.cat(walls)[None], torch.cat((RECTANGLE, RECTANGLE + 4))
    rast = rasterize_brute_force(pos, tri, SIDE, SIDE)
    color = (rast[..., 3:] > 2.5).double()
    assert color[0, 3, :5].all()
    assert not color[0, 3, 6:].any()
    gradient = gradient_of(color, rast, pos, tri, torch.ones_like(color))[0, :, 2]
    # The white wall is the second: it loses area as its depth grows. Pairs of pixels on diagonals have no edge.
    assert float(gradient[4:].sum()) == pytest.approx(-SIDE / (2 * slope), rel=0.2)
    assert float(gradient[:4].sum()) == pytest.approx(SIDE / (2 * slope), rel=0.2)


def test_one_pos_for_all_images_sums_their_gradients(rng: np.random.Generator) -> None:
    """Catches range mode that uses the first image only."""
    scene = random_scene(rng, batch=1)
    color, rast = (array.repeat(2, 1, 1, 1) for array in (scene.color, scene.rast))
    shared = gradient_of(color, rast, scene.pos[0], scene.tri, torch.ones_like(color))
    single = gradient_of(scene.color, scene.rast, scene.pos, scene.tri, torch.ones_like(scene.color))[0]
    torch.testing.assert_close(shared, 2 * single, rtol=1e-4, atol=1e-4 * float(single.abs().max()))


def test_hostile_values_give_no_error(rng: np.random.Generator) -> None:
    """Catches NaN that spreads from one vertex to the gradients of others, and empty meshes that fail."""
    scene = random_scene(rng)
    pos = scene.pos.clone()
    pos[0, 50] = torch.nan
    gradient = gradient_of(scene.color, scene.rast, pos, scene.tri, torch.ones_like(scene.color))
    assert gradient.isfinite().all()
    empty = torch.zeros(0, 3, dtype=torch.int32)
    rast = torch.zeros_like(scene.rast)
    assert torch.equal(edge_gradients(scene.color, rast, pos, empty), scene.color)
    with pytest.raises(ValueError, match="tri: expected vertex indices from 0 to 61, got 62"):
        edge_gradients(scene.color, rast, pos, torch.full((1, 3), 62, dtype=torch.int32))
