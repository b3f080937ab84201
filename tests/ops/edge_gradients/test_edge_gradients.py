"""Gradients of moving visibility edges: exact images, and the kernels compared with plain torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.loading import load_native
from fourd.rendering.triangles import antialias, antialias_construct_topology, edge_gradients
from tests.ops.antialias.scenes import RECTANGLE, Scene, random_scene, rasterize_brute_force, rectangle

SIDE = 12


def exact_square(x: float, y: float, size: float) -> Tensor:
    """The exact coverage (H, W) of a square whose first corner is at (x, y) pixels."""
    edges = torch.arange(SIDE + 1, dtype=torch.float64)
    columns, rows = ((edges[1:].clamp(max=at + size) - edges[:-1].clamp(min=at)).clamp(min=0) for at in (x, y))
    return rows[:, None] * columns


def gradient_of(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, upstream: Tensor, **settings: object) -> Tensor:
    leaf = pos.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(edge_gradients(color, rast, leaf, tri, **settings), leaf, upstream)  # type: ignore[arg-type]
    return gradient


def upstream_of(scene: Scene, rng: np.random.Generator) -> Tensor:
    return torch.from_numpy(rng.standard_normal(scene.color.shape).astype(np.float32))


def on(device: torch.device, scene: Scene) -> tuple[Tensor, ...]:
    return tuple(array.to(device) for array in (scene.color, scene.rast, scene.pos, scene.tri))


def assert_equal_gradients(found: Tensor, expected: Tensor) -> None:
    scale = float(expected.abs().max())
    assert scale > 0
    torch.testing.assert_close(found.cpu(), expected, rtol=1e-3, atol=1e-4 * scale)


@pytest.mark.parametrize("simd", ["baseline", "avx2"])
@pytest.mark.parametrize("channels", [1, 4])
def test_kernel_equals_the_reference(
    channels: int, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches swapped axes, derivatives of the wrong vertex, and intersections that only the kernel or only the
    reference finds."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    scene = random_scene(rng, channels=channels)
    arguments = (scene.color, scene.rast, scene.pos, scene.tri, upstream_of(scene, rng))
    assert_equal_gradients(gradient_of(*arguments), gradient_of(*arguments, backend="reference"))


def test_gpu_equals_the_reference(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches threads that read pairs beyond the border of the image, and gradients that are not cleared."""
    scene = random_scene(rng, size=(15, 18))
    upstream = upstream_of(scene, rng)
    expected = gradient_of(scene.color, scene.rast, scene.pos, scene.tri, upstream, backend="reference")
    assert_equal_gradients(gradient_of(*on(gpu, scene), upstream.to(gpu)), expected)


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator) -> None:
    """Catches pairs at the borders of tasks that are counted twice, and sums in random order."""
    scene = random_scene(rng, size=(101, 40))
    arguments = (scene.color, scene.rast, scene.pos, scene.tri, upstream_of(scene, rng))
    one, *others = (gradient_of(*arguments, threads=threads) for threads in (1, 2, 5))
    assert all(torch.equal(one, other) for other in others)


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes."""
    scene = random_scene(rng, batch=1, size=(6, 7))
    opposite = antialias_construct_topology(scene.tri).opposite
    for pos in (scene.pos, scene.pos[0]):
        arguments = (scene.color, scene.rast, pos, scene.tri, opposite, upstream_of(scene, rng), 0)
        torch.library.opcheck(torch.ops.fourd.edge_gradients.default, arguments)


@pytest.mark.parametrize("power", [1.0, 2.5])
def test_moving_square_has_the_slope_of_its_exact_image(power: float) -> None:
    """Catches a gradient of wrong sign or size. The edges lie between pixels, so that central differences of the exact
    image are the mean over the two pixels at an edge. ``power`` multiplies x, y, z and w, and does not move the
    vertices in the image."""
    rows, columns = torch.meshgrid(*(torch.arange(SIDE, dtype=torch.float64) + 0.5,) * 2, indexing="ij")
    weights = 0.3 * columns - 0.2 * rows + 0.05 * columns * rows
    x, y, size, step = 3.0, 4.0, 5.0, 1e-4
    # Pixels at two corners show the triangle that does not contain the left edge or the lower edge. These pixels have
    # the weight 0.
    weights[4, 2:4] = weights[8:10, 7] = 0

    def loss(dx: float, dy: float) -> float:
        return float((weights * exact_square(x + dx, y + dy, size)).sum())

    square = rectangle(x, y, x + size, y + size, SIDE, SIDE)[None]
    pos = power * square
    rast = rasterize_brute_force(square, RECTANGLE, SIDE, SIDE)
    color = (rast[..., 3:] > 0).double()
    gradient = gradient_of(color, rast, pos, RECTANGLE, weights[None, ..., None], backend="reference")
    found = gradient[0, :, :2].sum(0) * power * 2 / SIDE
    slopes = [(loss(step, 0) - loss(-step, 0)) / (2 * step), (loss(0, step) - loss(0, -step)) / (2 * step)]
    torch.testing.assert_close(found, torch.tensor(slopes, dtype=torch.float64), rtol=1e-6, atol=0)


def test_image_is_unchanged_and_its_gradient_is_the_identity(rng: np.random.Generator) -> None:
    """Catches an operator that changes the image, and gradients of colours that move to other pixels."""
    scene = random_scene(rng)
    color = scene.color.clone().requires_grad_()
    out = edge_gradients(color, scene.rast, scene.pos.requires_grad_(), scene.tri)
    assert torch.equal(out, color)
    upstream = torch.randn_like(color)
    assert torch.equal(torch.autograd.grad(out, color, upstream)[0], upstream)


def test_gradient_agrees_with_antialias_where_the_upstream_gradient_is_constant(rng: np.random.Generator) -> None:
    """Catches silhouettes that one of the two operators misses. If the upstream gradient is the same at all pixels,
    both operators have the same gradient."""
    scene = random_scene(rng, intersecting=False)
    upstream = torch.ones_like(scene.color)
    leaf = scene.pos.clone().requires_grad_()
    (expected,) = torch.autograd.grad(antialias(scene.color, scene.rast, leaf, scene.tri), leaf, upstream)
    found = gradient_of(scene.color, scene.rast, scene.pos, scene.tri, upstream)
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3 * float(expected.abs().max()))


def intersecting_walls(rng: np.random.Generator) -> Tensor:
    """Two triangles (1, 6, 4) float64, each of which covers the image. They intersect in the line x = d + k * y, in
    normalised device coordinates, with |d| < 0.3 and |k| < 0.5. Left of this line, the second triangle is nearer to the
    camera than the first triangle."""
    d, k = rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5)
    walls = []
    for sign in (-1, 1):
        # The corners surround the image, at random distances.
        angles = 2 * np.pi * (np.arange(3) / 3 + rng.uniform(0, 1)) + rng.uniform(-0.2, 0.2, 3)
        xy = rng.uniform(4, 5, (3, 1)) * np.stack((np.cos(angles), np.sin(angles)), 1)
        depth = rng.uniform(0.05, 0.1) * sign * (xy[:, 0] - d - k * xy[:, 1])
        # A common factor of x, y, z and w does not move a vertex in the image.
        walls.append(np.column_stack((xy, depth, np.ones(3))) * rng.uniform(0.7, 1.5, (3, 1)))
    return torch.from_numpy(np.concatenate(walls))[None]


def test_gpu_finds_intersections(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches derivatives with respect to z that the CUDA kernel does not add."""
    pos, tri = intersecting_walls(rng).float(), torch.arange(6, dtype=torch.int32).reshape(2, 3)
    rast = rasterize_brute_force(pos, tri, 12, 13)
    scene = Scene((rast[..., 3:] > 1.5).float(), rast, pos, tri)
    upstream = upstream_of(scene, rng)
    expected = gradient_of(scene.color, scene.rast, pos, tri, upstream, backend="reference")
    assert expected[..., 2].any()
    assert_equal_gradients(gradient_of(*on(gpu, scene), upstream.to(gpu)), expected)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_intersection_moves_as_the_line_of_equal_depth(backend: str, axis: int, rng: np.random.Generator) -> None:
    """Catches intersections that are missed or that count along both axes, and wrong derivatives. In each row, the
    exact image has one edge, which is where the planes of z/w of the two triangles intersect. ``axis`` 1 exchanges x
    and y."""
    side = 24
    pos, tri = intersecting_walls(rng), torch.arange(6, dtype=torch.int32).reshape(2, 3)
    rast = rasterize_brute_force(pos, tri, side, side)
    color = torch.from_numpy(rng.random((2, 3)))[(rast[..., 3] > 1.5).long()]
    weights = torch.from_numpy(rng.standard_normal((side, 3)))
    leaf = pos.clone().requires_grad_()
    planes = torch.linalg.solve(leaf[0, :, [0, 1, 3]].reshape(2, 3, 3), leaf[0, :, 2].reshape(2, 3, 1))[..., 0]
    x, y, w = planes[0] - planes[1]
    rows = (2 * torch.arange(side, dtype=torch.float64) + 1) / side - 1
    edges_px = -(y * rows + w) / x * side / 2
    loss = (edges_px[:, None] * weights * (color[0, :, 0] - color[0, :, -1])).sum()
    (expected,) = torch.autograd.grad(loss, leaf)
    upstream = weights[None, :, None].expand(1, side, side, 3)
    if axis == 1:
        rast, color, upstream = (array.transpose(1, 2).contiguous() for array in (rast, color, upstream))
        pos, expected = pos[..., [1, 0, 2, 3]], expected[..., [1, 0, 2, 3]]
    inputs = (color.float(), rast.float(), pos.float(), tri, upstream.float())
    assert_equal_gradients(gradient_of(*inputs, backend=backend), expected.float())


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
    ids = torch.tensor([len(scene.tri) + 1, 3e38, torch.inf, torch.nan, -5.0])
    rast = scene.rast.clone()
    rast[..., 3] = ids[torch.from_numpy(rng.integers(0, len(ids), rast.shape[:3]))]
    assert not gradient_of(scene.color, rast, scene.pos, scene.tri, torch.ones_like(scene.color)).any()
    empty = torch.zeros(0, 3, dtype=torch.int32)
    rast = torch.zeros_like(scene.rast)
    assert torch.equal(edge_gradients(scene.color, rast, pos, empty), scene.color)
    with pytest.raises(ValueError, match="tri: expected vertex indices from 0 to 61, got 62"):
        edge_gradients(scene.color, rast, pos, torch.full((1, 3), 62, dtype=torch.int32))
