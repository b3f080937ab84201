"""Compositing of discs along rays, compared with plain torch and with the compositor of points."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.points.arrays import render_points_numpy
from fourd.rendering.ops.rays.cuda import GpuDiscTree
from fourd.rendering.ops.rays.discs import DiscTree
from fourd.rendering.ops.rays.reference import composite_discs_reference
from fourd.scene.lenses.lens import Pinhole
from tests.baking.scenes import ring


def discs(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Centres, radii, densities (some above 1) and colours."""
    return (
        rng.normal(0, 0.3, (count, 3)).astype(np.float32),
        rng.uniform(0.02, 0.1, count).astype(np.float32),
        rng.uniform(0.1, 1.2, count).astype(np.float32),
        rng.random((count, 3)).astype(np.float32),
    )


@pytest.mark.parametrize("simd", ["baseline", "avx2"])
@pytest.mark.parametrize(("count", "layers"), [(0, 4), (1, 1), (7, 3), (2000, 12), (500, 64)])
@pytest.mark.parametrize("is_facing", [True, False])
def test_colours_equal_the_reference(
    count: int, layers: int, is_facing: bool, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches discs that are missing in the tree, a wrong order, and wrong values of t for directions that are not
    normalised.
    """
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    xyz, radius, density, colours = discs(rng, count)
    origins = rng.uniform(-1.5, 1.5, (400, 3)).astype(np.float32)
    directions = (rng.normal(0, 0.2, (400, 3)) - origins) * 10.0 ** rng.uniform(-3, 3, (400, 1))
    facing = np.array([0.3, -0.2, 0.9], np.float32) if is_facing else None
    rays = origins, directions.astype(np.float32)
    found = DiscTree(xyz, radius, density).composite(colours, *rays, facing=facing, layers=layers)
    tensors = [torch.from_numpy(array).double() for array in (xyz, radius, density, colours, *rays)]
    plane = None if facing is None else torch.from_numpy(facing).double()
    expected = composite_discs_reference(*tensors, plane, 0.0, layers).numpy()
    # Rounding decides whether a ray hits the rim of a disc, and in which order it hits discs at nearly the same t.
    difference = np.abs(found - expected).max(1)
    assert np.mean(difference > 1e-4) <= 0.01
    assert count < 100 or expected[:, 3].max() > 0.3


def test_a_pinhole_shows_the_picture_of_the_compositor(rng: np.random.Generator) -> None:
    """Catches discs whose shape or order differs from the discs of the point compositor."""
    xyz, radius, density, colours = discs(rng, 4000)
    camera = ring(3, size=96)[1]
    rgb, alpha, _ = render_points_numpy(xyz, colours, radius, density.clip(max=1), camera, layers=12, near=0.01)
    rays = Pinhole().rays(camera)
    origins, directions = rays.origins.astype(np.float32), rays.directions.astype(np.float32)
    found = DiscTree(xyz, radius, density).composite(
        colours, origins, directions, facing=camera.forward.astype(np.float32), t_min=0.01, layers=12
    )
    expected = np.concatenate([rgb, alpha[..., None]], 2).reshape(-1, 4)
    assert np.abs(found - expected).mean() <= 1e-4
    assert expected[:, 3].mean() > 0.05


@pytest.mark.parametrize("simd", ["baseline", "avx2"])
@pytest.mark.parametrize("is_facing", [True, False])
def test_a_gpu_gives_the_colours_of_the_cpu(
    is_facing: bool, simd: str, gpu: torch.device, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches hit tests that differ between the vector instructions of the CPU and the GPU, and limits of t that are
    ignored.
    """
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    for count, layers in ((0, 1), (5, 2), (3000, 12), (600, 64)):
        xyz, radius, density, colours = discs(rng, count)
        radius[: count // 10], density[count // 10 : count // 5] = np.nan, -1
        origins = rng.uniform(-1.5, 1.5, (300, 3)).astype(np.float32)
        directions = (rng.normal(0, 0.2, (300, 3)) - origins).astype(np.float32)
        directions[:3] = [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 1]]
        t_max = rng.uniform(0.5, 3, 300).astype(np.float32)
        facing = np.array([0.3, -0.2, 0.9], np.float32) if is_facing else None
        settings = {"t_min": 0.1, "layers": layers}
        tree = DiscTree(xyz, radius, density)
        expected = tree.composite(colours, origins, directions, facing=facing, t_max=t_max, **settings)
        on_gpu = [torch.from_numpy(array).to(gpu) for array in (xyz, radius, density, colours, origins, directions)]
        found = GpuDiscTree(*on_gpu[:3]).composite(
            *on_gpu[3:],
            facing=None if facing is None else torch.from_numpy(facing).to(gpu),
            t_max=torch.from_numpy(t_max).to(gpu),
            **settings,
        )
        np.testing.assert_array_equal(found.cpu().numpy(), expected)
        assert count < 100 or expected[:, 3].max() > 0.3


def test_wrong_tensors_are_named(gpu: torch.device) -> None:
    """Catches tensors of wrong shape that reach the CUDA kernel. The kernel would read past their end."""
    xyz, ones = torch.zeros(3, 3, device=gpu), torch.ones(3, device=gpu)
    with pytest.raises(ValueError, match="radius: expected"):
        GpuDiscTree(xyz, ones[:2], ones)
    tree = GpuDiscTree(xyz, ones, ones)
    with pytest.raises(ValueError, match="colours: expected"):
        tree.composite(xyz[:2], xyz, xyz)
    with pytest.raises(ValueError, match="directions: expected"):
        tree.composite(xyz, xyz, xyz[:2])
    with pytest.raises(ValueError, match="t_max: expected"):
        tree.composite(xyz, xyz, xyz, t_max=ones[:2])
    with pytest.raises(ValueError, match="layers: expected 1 to 64, got 0"):
        tree.composite(xyz, xyz, xyz, layers=0)


def test_limits_hide_discs(rng: np.random.Generator) -> None:
    """Catches limits that are not in multiples of the direction's length, and limits that belong to a different ray."""
    xyz = np.array([[0, 0, 2], [0, 0, 4]], np.float32)
    tree = DiscTree(xyz, np.ones(2, np.float32), np.full(2, 0.5, np.float32))
    colours = np.array([[1, 0, 0], [0, 1, 0]], np.float32)
    origins, directions = np.zeros((3, 3), np.float32), np.tile(np.array([0, 0, 0.5], np.float32), (3, 1))
    t_max = np.array([np.inf, 6, 3], np.float32)
    found = tree.composite(colours, origins, directions, t_max=t_max)
    np.testing.assert_allclose(found, [[0.5, 0.25, 0, 0.75], [0.5, 0, 0, 0.5], [0, 0, 0, 0]], atol=1e-6)
    found = tree.composite(colours, origins, directions, t_min=5.0)
    np.testing.assert_allclose(found[0], [0, 0.5, 0, 0.5], atol=1e-6)


def test_invalid_discs_and_rays_hit_nothing() -> None:
    """Catches NaN that reaches the picture, and discs with a radius of 0."""
    xyz = np.zeros((5, 3), np.float32)
    xyz[0, 1], xyz[1, 2] = np.nan, np.inf
    radius = np.array([1, 1, 0, -1, np.inf], np.float32)
    tree = DiscTree(xyz, radius, np.ones(5, np.float32))
    rays = np.array([[0, 0, 1], [0, 0, 0], [np.nan, 0, 1], [0, np.inf, 0]], np.float32)
    found = tree.composite(np.ones((5, 3), np.float32), np.tile(np.float32([0, 0, -2]), (4, 1)), rays)
    assert not found.any()
    tree = DiscTree(np.zeros((1, 3), np.float32), np.ones(1, np.float32), np.ones(1, np.float32))
    found = tree.composite(np.ones((1, 3), np.float32), np.tile(np.float32([0, 0, -2]), (4, 1)), rays)
    np.testing.assert_array_equal(found[:, 3], [1, 0, 0, 0])


def test_wrong_arguments_are_named() -> None:
    """Catches arrays of wrong shape that reach the kernel. The kernel would read past their end."""
    points = np.zeros((3, 3), np.float32), np.ones(3, np.float32), np.ones(3, np.float32)
    with pytest.raises(ValueError, match=r"radius: expected float32 of shape \(3,\), got float32 of shape \(2,\)"):
        DiscTree(points[0], points[1][:2], points[2])
    tree = DiscTree(*points)
    rays = np.zeros((2, 3), np.float32), np.ones((2, 3), np.float32)
    with pytest.raises(ValueError, match=r"colours: expected float32 of shape \(3, 3\), got float64 of shape \(3, 3\)"):
        tree.composite(points[0].astype(np.float64), *rays)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="layers: expected 1 to 64, got 65"):
        tree.composite(points[0], *rays, layers=65)
