"""Ray tracing compared with a loop over all triangles: hits, order, gradients, threads, trees and wrong arguments."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.rays.op import trace_rays
from fourd.rendering.rays import Bvh, Hits, occluded, trace, visibility
from tests.raster.rays.soups import hard_soup, random_rays, random_soup, rays_at_vertices, sphere

Mesh = tuple[Tensor, Tensor]


@pytest.fixture(params=["baseline", "avx2", "emulated"])
def kernels(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Select each instruction set, and the emulated CUDA kernels."""
    if request.param == "emulated":
        pytest.importorskip("fourd._emulated")
    elif not load_native().simd_available(request.param):
        pytest.skip(f"this machine does not run {request.param}")
    monkeypatch.setenv("FOURD_SIMD", request.param)
    return str(request.param)


def meshes(rng: np.random.Generator) -> list[Mesh]:
    return [random_soup(rng, 300), hard_soup(rng), sphere(12)]


def rays_for(rng: np.random.Generator, xyz: Tensor) -> tuple[Tensor, Tensor]:
    pairs = [random_rays(rng, 400), rays_at_vertices(rng, xyz, 200)]
    return torch.cat([pair[0] for pair in pairs]), torch.cat([pair[1] for pair in pairs])


def assert_same_hits(found: Hits, expected: Hits) -> None:
    """Assert that the triangles are equal. t, u and v have a tolerance, because the reference solves for them with a
    different method.
    """
    assert torch.equal(found.triangle, expected.triangle)
    assert torch.equal(torch.isinf(found.t), torch.isinf(expected.t))


@pytest.mark.parametrize("layers", [1, 3, 16])
def test_hits_are_those_of_a_loop_over_all_triangles(layers: int, kernels: str, rng: np.random.Generator) -> None:
    """Catches bounding boxes that are too small, a wrong order of hits with equal t, and triangles that are missed at a
    common edge.
    """
    for xyz, tri in meshes(rng):
        bvh = Bvh.build(xyz, tri)
        origins, directions = rays_for(rng, xyz)
        found = trace(bvh, xyz, origins, directions, layers=layers)
        assert_same_hits(found, trace(bvh, xyz, origins, directions, layers=layers, backend="reference"))
        assert int(found.is_hit.sum()) > 50


def test_limits_of_t_are_those_of_a_loop(kernels: str, rng: np.random.Generator) -> None:
    """Catches limits in units of length instead of multiples of the direction, and a hit exactly at a limit that is
    missed.
    """
    xyz, tri = random_soup(rng, 300)
    bvh = Bvh.build(xyz, tri)
    origins, directions = random_rays(rng, 600)
    nearest = trace(bvh, xyz, origins, directions)
    t = nearest.t[:, 0]
    exact = trace(bvh, xyz, origins, directions, t_min=t.clamp(max=1e30), t_max=t)
    assert torch.equal(exact.triangle, nearest.triangle)
    limits = torch.from_numpy(rng.uniform(-2, 2, (2, 600)).astype(np.float32)) / directions.norm(dim=1)
    limits = limits.nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)
    found, expected = (
        trace(bvh, xyz, origins, directions, t_min=limits[0], t_max=limits[1], layers=4, backend=backend)
        for backend in ("auto", "reference")
    )
    assert_same_hits(found, expected)
    assert not bool(found.is_hit[limits[0] > limits[1]].any())


def test_chunks_continue_at_equal_t(kernels: str, rng: np.random.Generator) -> None:
    """Catches coplanar triangles that are lost or found twice where one call ends and the next begins."""
    corners = torch.from_numpy(rng.uniform(-1, 1, (30, 3, 3)).astype(np.float32))
    corners[:, :, 2] = torch.tensor([0.0, 0.5, 0.5])[torch.from_numpy(rng.integers(3, size=30))][:, None]
    xyz, tri = corners.reshape(-1, 3), torch.arange(90, dtype=torch.int32).reshape(-1, 3)
    bvh = Bvh.build(xyz, tri)
    origins = torch.from_numpy(rng.uniform(-0.5, 0.5, (200, 3)).astype(np.float32))
    origins[:, 2] = -1
    directions = torch.tensor([0.0, 0.0, 1.0]).expand(200, 3).contiguous()
    whole = trace(bvh, xyz, origins, directions, layers=31)
    assert bool((whole.triangle[:, -1] < 0).all())
    parts, after = [], None
    for _ in range(11):
        part = trace(bvh, xyz, origins, directions, layers=3, after=after)
        parts.append(part.triangle)
        after = part.last()
    assert torch.equal(torch.cat(parts, 1)[:, :31], whole.triangle)


def test_t_u_and_v_solve_the_equation_of_the_ray(kernels: str, rng: np.random.Generator) -> None:
    """Catches swapped weights, and t in units of length instead of multiples of the direction."""
    xyz, tri = random_soup(rng, 300)
    origins, directions = random_rays(rng, 600)
    hits = trace(Bvh.build(xyz, tri), xyz, origins, directions, layers=2)
    ray, layer = hits.is_hit.nonzero(as_tuple=True)
    a, b, c = xyz[tri[hits.triangle[ray, layer].long()].long()].unbind(1)
    u, v, t = (value[ray, layer, None] for value in (hits.u, hits.v, hits.t))
    torch.testing.assert_close(origins[ray] + t * directions[ray], u * a + v * b + (1 - u - v) * c, rtol=0, atol=2e-5)


def test_gradients_equal_those_of_the_reference_in_float64(kernels: str, rng: np.random.Generator) -> None:
    """Catches wrong signs and transposed matrices in the gradient, and wrong sums over hits that share a vertex or a
    ray.
    """
    xyz, tri = sphere(8)
    origins = torch.from_numpy(rng.uniform(-0.3, 0.3, (80, 3)).astype(np.float32))
    directions = torch.from_numpy(rng.normal(0, 1, (80, 3)).astype(np.float32))
    bvh = Bvh.build(xyz, tri)
    gradients = []
    weights = torch.from_numpy(rng.normal(0, 1, (3, 80, 2)))
    for backend, dtype in (("auto", torch.float32), ("reference", torch.float64)):
        leaves = [value.to(dtype).requires_grad_() for value in (xyz, origins, directions)]
        hits = trace(bvh, *leaves, layers=2, backend=backend)
        is_far = hits.is_hit & (hits.u > 0.02) & (hits.v > 0.02) & (hits.u + hits.v < 0.98)
        values = (torch.where(is_far, each, 0) for each in (hits.t, hits.u, hits.v))
        loss = sum(((weight.to(dtype) * value).sum() for weight, value in zip(weights, values, strict=True)))
        gradients.append(torch.autograd.grad(loss, leaves))
    for found, expected in zip(*gradients, strict=True):
        torch.testing.assert_close(found.double(), expected, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))


def test_reference_gradients_equal_finite_differences(rng: np.random.Generator) -> None:
    """Catches an error that the gradients of the kernel and of the reference have in common."""
    # A random triangle can be so narrow that the differences are far from the derivatives.
    regular = torch.tensor([[-0.8, -0.6, 1], [0.8, -0.6, 1], [0, 0.8, 1]])
    xyz = (regular + torch.from_numpy(rng.uniform(-0.2, 0.2, (3, 3)))).float().double()
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    origins = torch.from_numpy(rng.uniform(-0.1, 0.1, (4, 3)))
    directions = xyz.mean(0) - origins

    def values(*leaves: Tensor) -> Tensor:
        hits = trace(Bvh.build(leaves[0].detach().float(), tri), *leaves, backend="reference")
        return torch.stack([hits.t, hits.u, hits.v])

    # Float32 represents the shifted positions exactly, so that the tree and the reference have equal positions.
    step = 2.0**-12
    leaves = [value.clone().requires_grad_() for value in (xyz, origins, directions)]
    weights = torch.from_numpy(rng.normal(0, 1, (3, 4, 1)))
    gradients = torch.autograd.grad((values(*leaves) * weights).sum(), leaves)
    for leaf, gradient in zip(leaves, gradients, strict=True):
        for index in np.ndindex(*leaf.shape):
            sums = []
            for sign in (1, -1):
                moved = [each.detach().clone() for each in leaves]
                moved[[each is leaf for each in leaves].index(True)][index] += sign * step
                moved[0] = moved[0].float().double()
                sums.append(float((values(*moved) * weights).sum()))
            assert abs((sums[0] - sums[1]) / (2 * step) - float(gradient[index])) <= 1e-3 * max(
                1.0, float(gradient.abs().max())
            )


def test_occlusion_is_a_hit_in_the_limits(kernels: str, rng: np.random.Generator) -> None:
    """Catches a traversal that ends too early, and hits outside the limits."""
    for xyz, tri in meshes(rng):
        bvh = Bvh.build(xyz, tri)
        origins, directions = rays_for(rng, xyz)
        t_max = torch.from_numpy(rng.uniform(0, 3, len(origins)).astype(np.float32))
        hits = trace(bvh, xyz, origins, directions, t_max=t_max)
        assert torch.equal(occluded(bvh, origins, directions, t_max=t_max), hits.is_hit[:, 0])


def test_a_sphere_is_closed(kernels: str, rng: np.random.Generator) -> None:
    """Catches gaps at edges and vertices. No ray from inside a closed mesh may leave the mesh."""
    xyz, tri = sphere()
    aims = [rays_at_vertices(rng, xyz, 2000)[1], torch.from_numpy(rng.normal(0, 1, (2000, 3)).astype(np.float32))]
    targets = torch.cat([xyz[torch.from_numpy(rng.integers(len(xyz), size=2000))], *aims])
    origins = torch.from_numpy(rng.uniform(-0.4, 0.4, (len(targets), 3)).astype(np.float32))
    assert bool(occluded(Bvh.build(xyz, tri), origins, targets - origins).all())


def test_visibility_between_points(rng: np.random.Generator) -> None:
    """Catches swapped axes of the result, and a surface that occludes its own points."""
    xyz, tri = sphere(16)
    bvh = Bvh.build(xyz, tri)
    inside = torch.from_numpy(rng.uniform(-0.3, 0.3, (3, 3)).astype(np.float32))
    outside = torch.tensor([[3.0, 0, 0], [0, 3.0, 0]])
    assert not bool(visibility(bvh, inside, outside).any())
    assert bool(visibility(bvh, inside, inside[:2]).all())
    seen = visibility(bvh, xyz[tri[:, 0].long()][40:80], outside)
    assert seen.shape == (40, 2)
    assert 0 < int(seen.sum()) < 80


def test_results_do_not_depend_on_threads(rng: np.random.Generator) -> None:
    """Catches trees and sums that depend on the order of tasks."""
    xyz, tri = random_soup(rng, 30_000, 0.02)
    trees = [Bvh.build(xyz, tri, threads=threads) for threads in (1, 3)]
    assert torch.equal(trees[0].nodes.view(torch.int32), trees[1].nodes.view(torch.int32))
    assert torch.equal(trees[0].blocks.view(torch.int32), trees[1].blocks.view(torch.int32))
    origins, directions = random_rays(rng, 10_000)
    results = []
    for threads in (1, 3):
        leaf = xyz.clone().requires_grad_()
        hits = trace(trees[0], leaf, origins, directions, layers=2, threads=threads)
        loss = torch.where(hits.is_hit, hits.u, 0).sum()
        results.append([hits.t.detach(), hits.u.detach(), hits.triangle, torch.autograd.grad(loss, leaf)[0]])
    assert all(torch.equal(one, other) for one, other in zip(*results, strict=True))


def test_a_refitted_tree_finds_the_hits_of_a_new_tree(rng: np.random.Generator) -> None:
    """Catches bounding boxes that are not updated, and triangles whose positions were NaN when the tree was built."""
    xyz, tri = hard_soup(rng)
    bvh = Bvh.build(xyz, tri)
    moved = torch.from_numpy(rng.uniform(-1, 1, xyz.shape).astype(np.float32))
    origins, directions = random_rays(rng, 500)
    found = trace(bvh.refit(moved), moved, origins, directions, layers=8)
    expected = trace(Bvh.build(moved, tri), moved, origins, directions, layers=8)
    assert torch.equal(found.triangle, expected.triangle)
    assert torch.equal(found.t, expected.t)
    updated = bvh.update(moved, rebuild_above=0.0)
    assert torch.equal(updated.nodes.view(torch.int32), Bvh.build(moved, tri).nodes.view(torch.int32))


@pytest.mark.parametrize("count", [0, 1, 8, 9])
def test_small_meshes(count: int, kernels: str, rng: np.random.Generator) -> None:
    """Catches reads from an empty tree, and wrong results for a tree whose root is a leaf block."""
    xyz, tri = random_soup(rng, max(count, 1))
    bvh = Bvh.build(xyz, tri[:count])
    origins, directions = random_rays(rng, 300)
    found, expected = (
        trace(bvh, xyz, origins, directions, layers=9, backend=backend) for backend in ("auto", "reference")
    )
    assert_same_hits(found, expected)


def test_equal_triangles_and_far_scales(kernels: str) -> None:
    """Catches a tree builder that cannot split triangles with equal centres, and a traversal whose stack is too
    small.
    """
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]).repeat(3000, 1, 1)
    corners[1000:2000] *= torch.logspace(-15, 15, 1000)[:, None, None]
    xyz, tri = corners.reshape(-1, 3), torch.arange(9000, dtype=torch.int32).reshape(-1, 3)
    bvh = Bvh.build(xyz, tri)
    origins, directions = torch.tensor([[0.1, 0.1, 1.0]]), torch.tensor([[0.0, 0.0, -2.0]])
    hits = trace(bvh, xyz, origins, directions, layers=1024)
    expected = trace(bvh, xyz, origins, directions, layers=1024, backend="reference")
    assert_same_hits(hits, expected)
    assert int(hits.is_hit.sum()) == 1024


def test_directions_without_a_length_hit_nothing(kernels: str, rng: np.random.Generator) -> None:
    """Catches rays with zero, NaN or infinite directions that hang or report hits."""
    xyz, tri = random_soup(rng, 100, 1.0)
    bvh = Bvh.build(xyz, tri)
    bad = torch.tensor([[0.0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 1], [1e-30, 0, 0], [0, 1e30, 0]])
    good = torch.tensor([[0.0, 0, 1]]).expand(5, 3)
    for origins, directions in ((torch.zeros(5, 3), bad), (bad[[1, 2, 4]], good[:3].contiguous())):
        assert not bool(trace(bvh, xyz, origins, directions).is_hit.any())
        assert not bool(occluded(bvh, origins, directions).any())


def test_wrong_arguments_are_named(rng: np.random.Generator) -> None:
    """Catches tensors of wrong shape that reach the kernel, and a tree that was built for other positions."""
    xyz, tri = random_soup(rng, 20)
    bvh = Bvh.build(xyz, tri)
    rays = torch.zeros(4, 3), torch.ones(4, 3)
    with pytest.raises(ValueError, match=r"xyz: expected the positions that the tree was built for"):
        trace(bvh, xyz + 1, *rays)
    with pytest.raises(
        ValueError, match=r"xyz: expected the 60 vertices that the tree was built for, got 3; build a new"
    ):
        bvh.refit(xyz[:3])
    with pytest.raises(ValueError, match=r"t_min: expected at most t_max, got 2.0 and 1.0"):
        trace(bvh, xyz, *rays, t_min=2.0, t_max=1.0)
    one_ray = rays[0][:1], rays[1][:1]
    assert not trace(bvh, xyz, *one_ray, t_min=torch.full((1,), 2.0), t_max=torch.ones(1)).is_hit.any()
    with pytest.raises(ValueError, match=r"origins: expected at most 2147483647 rays, got 2147483648; trace them in"):
        trace(bvh, xyz, *(torch.zeros(1, 3).expand(2**31, 3) for _ in range(2)))
    with pytest.raises(ValueError, match=r"t_max: expected a number, got NaN"):
        trace(bvh, xyz, *rays, t_max=float("nan"))
    with pytest.raises(ValueError, match=r"layers: expected 1 to 1024, got 0"):
        trace(bvh, xyz, *rays, layers=0)
    with pytest.raises(ValueError, match=r"directions: expected 4 rays, as in origins, got 2"):
        trace(bvh, xyz, rays[0], rays[1][:2])
    with pytest.raises(TypeError, match=r"directions: expected dtype float32, got float64"):
        trace(bvh, xyz, rays[0], rays[1].double())
    with pytest.raises(ValueError, match=r"tri: expected vertex indices from 0 to 2, got 3"):
        Bvh.build(xyz[:3], torch.tensor([[0, 1, 3]], dtype=torch.int32))
    with pytest.raises(ValueError, match=r"margin: expected a share from 0 to 0.5, got 0.7"):
        visibility(bvh, *rays, margin=0.7)


def test_the_bindings_check_arguments() -> None:
    """Catches a division by zero and reads past the end of arrays, if a caller does not use fourd.rendering."""
    native, rays, xyz = load_native(), np.ones((4, 3), np.float32), np.ones((3, 3), np.float32)
    tri = np.array([[0, 1, 2], [0, 1, 3], [-1, 1, 2]], np.int32)
    none, outputs = np.zeros((4, 0), np.float32), (np.zeros_like(xyz), np.zeros_like(rays), np.zeros_like(rays))
    with pytest.raises(ValueError, match=r"layers: expected 1 to 2\^20"):
        native.trace_rays_backward(
            xyz, tri, rays, rays, none, none, none, none.astype(np.int32), none, none, none, 1, *outputs
        )
    hits = np.ones((4, 1), np.float32)
    triangle = np.array([[1], [2], [3], [2**31 - 1]], np.int32)
    native.trace_rays_backward(xyz, tri, rays, rays, hits, hits, hits, triangle, hits, hits, hits, 1, *outputs)
    assert not any(out.any() for out in outputs)
    nodes, blocks, _ = native.build_rays(xyz, tri, 1)
    assert np.isfinite(native.rays_cost(nodes, blocks))


def test_the_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and gradients that torch.compile cannot use."""
    xyz, tri = random_soup(rng, 20)
    bvh = Bvh.build(xyz, tri)
    origins, directions = (value.requires_grad_() for value in random_rays(rng, 30))
    limits = torch.zeros(1), torch.full((1,), torch.inf)
    rays = (xyz.clone().requires_grad_(), tri, origins, directions, *limits, None, None)
    torch.library.opcheck(
        trace_rays.defined,
        (bvh.nodes, bvh.blocks, bvh.magnitude, *rays, 2, 1),
        test_utils=("test_schema", "test_autograd_registration", "test_faketensor"),
    )
