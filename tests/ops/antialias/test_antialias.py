"""The antialiasing kernels compared with plain torch: values, gradients, instruction sets, threads and bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.loading import load_native
from fourd.rendering.triangles import antialias, antialias_construct_topology
from tests.ops.antialias.scenes import Scene, random_scene


def results(scene: Scene, upstream: Tensor, device: str | torch.device = "cpu", **settings: object) -> list[Tensor]:
    """Image, gradient of the colours and gradient of the positions."""
    color, pos = (array.to(device, copy=True).requires_grad_() for array in (scene.color, scene.pos))
    out = antialias(color, scene.rast.to(device), pos, scene.tri.to(device), **settings)  # type: ignore[arg-type]
    gradients = torch.autograd.grad(out, (color, pos), upstream.to(device))
    return [tensor.detach().cpu() for tensor in (out, *gradients)]


def upstream_of(scene: Scene, rng: np.random.Generator) -> Tensor:
    return torch.from_numpy(rng.standard_normal(scene.color.shape).astype(np.float32))


def double(scene: Scene) -> Scene:
    return Scene(scene.color.double(), scene.rast.double(), scene.pos.double(), scene.tri)


def assert_equal_results(found: list[Tensor], expected: list[Tensor]) -> None:
    torch.testing.assert_close(found[0], expected[0], rtol=1e-5, atol=2e-5)
    torch.testing.assert_close(found[1], expected[1], rtol=1e-5, atol=1e-4)
    scale = float(expected[2].abs().max())
    assert scale > 0
    torch.testing.assert_close(found[2], expected[2], rtol=1e-3, atol=1e-4 * scale)


@pytest.mark.parametrize("simd", ["baseline", "avx2"])
@pytest.mark.parametrize("channels", [1, 3, 5])
def test_values_and_gradients_equal_the_reference(
    channels: int, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches swapped axes, a wrong owner of a pair, and derivatives of the wrong vertex."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    scene = random_scene(rng, channels=channels)
    upstream = upstream_of(scene, rng)
    assert_equal_results(results(scene, upstream), results(scene, upstream, backend="reference"))


def test_gpu_equals_the_reference(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a pixel whose edge crossings to the pixel above or to the left are missed, and gradients that are not
    cleared.
    """
    scene = random_scene(rng, size=(15, 18))
    upstream = upstream_of(scene, rng)
    assert_equal_results(results(scene, upstream, gpu), results(scene, upstream, backend="reference"))


def test_gpu_image_has_the_bits_of_the_cpu(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches crossings whose order of addition differs from that on the CPU."""
    scene = random_scene(rng, size=(15, 18))
    upstream = upstream_of(scene, rng)
    on_gpu = results(scene, upstream, gpu)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("FOURD_SIMD", raising=False)
        on_cpu = results(scene, upstream)
    assert torch.equal(on_gpu[0], on_cpu[0])
    assert torch.equal(on_gpu[1], on_cpu[1])


def test_one_pos_for_all_images_equals_its_copies(rng: np.random.Generator) -> None:
    """Catches range mode that reads the vertices of the first image only, or does not sum the gradients of images."""
    scene = random_scene(rng, batch=1)
    several = Scene(*(array.repeat(3, 1, 1, 1) for array in (scene.color, scene.rast)), scene.pos[0], scene.tri)
    upstream = upstream_of(several, rng)
    shared = results(several, upstream)
    instanced = results(replace(several, pos=scene.pos.repeat(3, 1, 1)), upstream)
    assert torch.equal(shared[0], instanced[0])
    torch.testing.assert_close(shared[2], instanced[2].sum(0), rtol=1e-4, atol=1e-4)
    assert_equal_results(shared, results(several, upstream, backend="reference"))


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator) -> None:
    """Catches rows at the borders of tasks that are blended twice or in the wrong order, and sums in random order."""
    scene = random_scene(rng, size=(101, 40))
    upstream = upstream_of(scene, rng)
    one, *others = (results(scene, upstream, threads=threads) for threads in (1, 2, 5))
    for other in others:
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


def test_boost_multiplies_the_gradient_of_pos_only(rng: np.random.Generator) -> None:
    """Catches a gradient boost that is applied twice, or that is applied to the gradients of the colours."""
    scene = random_scene(rng)
    upstream = upstream_of(scene, rng)
    for backend in ("cpu", "reference"):
        plain = results(scene, upstream, backend=backend)
        boosted = results(scene, upstream, backend=backend, pos_gradient_boost=4.0)
        assert torch.equal(plain[0], boosted[0])
        assert torch.equal(plain[1], boosted[1])
        torch.testing.assert_close(boosted[2], 4 * plain[2], rtol=1e-5, atol=1e-5 * float(plain[2].abs().max()))


def test_reference_gradients_equal_finite_differences(rng: np.random.Generator) -> None:
    """Catches an error that the gradients of the kernel and of the reference have in common. The reference's image is
    linear in the colours and smooth in pos while the same edges are crossed."""
    scene = double(random_scene(rng, batch=1, size=(14, 17), intersecting=False))
    color, pos = scene.color.clone().requires_grad_(), scene.pos.clone().requires_grad_()
    upstream = torch.from_numpy(rng.standard_normal(color.shape))

    def loss(color: Tensor, pos: Tensor) -> Tensor:
        return (upstream * antialias(color, scene.rast, pos, scene.tri, backend="reference")).sum()

    gradients = torch.autograd.grad(loss(color, pos), (color, pos))
    step = 1e-7
    for k, (leaf, gradient) in enumerate(zip((color, pos), gradients, strict=True)):
        for _ in range(5):
            direction = torch.from_numpy(rng.standard_normal(leaf.shape))
            moved = [[color.detach(), pos.detach()] for _ in range(2)]
            moved[0][k], moved[1][k] = leaf.detach() + step * direction, leaf.detach() - step * direction
            slope = (loss(*moved[0]) - loss(*moved[1])) / (2 * step)
            torch.testing.assert_close((gradient * direction).sum(), slope, rtol=1e-4, atol=1e-4)


def test_topology_argument_gives_the_same_bits(rng: np.random.Generator) -> None:
    """Catches results that differ between a topology computed in advance and a topology computed in the call."""
    scene = random_scene(rng)
    upstream = upstream_of(scene, rng)
    topology = antialias_construct_topology(scene.tri)
    one, two = results(scene, upstream), results(scene, upstream, topology=topology)
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and a backward pass that autograd cannot trace."""
    scene = random_scene(rng, batch=1, size=(6, 7))
    opposite = antialias_construct_topology(scene.tri).opposite
    for pos in (scene.pos, scene.pos[0]):
        leaves = (scene.color.clone().requires_grad_(), scene.rast, pos.clone().requires_grad_(), scene.tri, opposite)
        torch.library.opcheck(torch.ops.fourd.antialias.default, (*leaves, 1.0, 0))


def test_vertices_that_are_not_finite_change_nothing(rng: np.random.Generator) -> None:
    """Catches NaN that spreads from a vertex to the image or to the gradients of other vertices."""
    scene = random_scene(rng)
    pos = scene.pos.clone()
    pos[0, 50] = torch.nan
    pos[1, 53, 3] = torch.inf
    hostile = replace(scene, pos=pos)
    upstream = upstream_of(scene, rng)
    found = results(hostile, upstream)
    assert all(tensor.isfinite().all() for tensor in found)
    assert not found[2][0, 50].any()


def test_ids_out_of_range_count_as_background(rng: np.random.Generator) -> None:
    """Catches a crash for ids of another mesh, negative ids and NaN."""
    scene = random_scene(rng)
    rast = scene.rast.clone()
    ids = torch.tensor([len(scene.tri) + 1, 1e9, 3e38, torch.inf, torch.nan, -5.0])
    rast[..., 3] = ids[torch.from_numpy(rng.integers(0, len(ids), rast.shape[:3]))]
    found = results(replace(scene, rast=rast), upstream_of(scene, rng))
    assert torch.equal(found[0], scene.color)
    assert not found[2].any()


@pytest.mark.parametrize("batch", [0, 1])
def test_empty_meshes_and_batches(batch: int) -> None:
    """Catches gradients that are not initialised if there is nothing to blend."""
    scene = Scene(
        torch.ones(batch, 3, 4, 2),
        torch.zeros(batch, 3, 4, 4),
        torch.zeros(batch, 0, 4),
        torch.zeros(0, 3, dtype=torch.int32),
    )
    for backend in ("cpu", "reference"):
        found = results(scene, torch.ones(batch, 3, 4, 2), backend=backend)
        assert torch.equal(found[0], scene.color)
        assert torch.equal(found[1], torch.ones_like(scene.color))
        assert found[2].shape == (batch, 0, 4)


def test_invalid_arguments_are_named(rng: np.random.Generator) -> None:
    """Catches arrays of the wrong shape or dtype that reach a kernel."""
    scene = random_scene(rng, batch=2, size=(5, 6))
    good = (scene.color, scene.rast, scene.pos, scene.tri)
    with pytest.raises(ValueError, match=r"color: expected shape \(B, H, W, C\), got \(5, 6, 3\)"):
        antialias(good[0][0], *good[1:])
    with pytest.raises(ValueError, match=r"rast: expected shape \(2, 5, 6, 4\), got \(1, 5, 6, 4\)"):
        antialias(good[0], good[1][:1], *good[2:])
    with pytest.raises(ValueError, match=r"pos: expected shape \(2, V, 4\), got \(1, 62, 4\)"):
        antialias(*good[:2], good[2][:1], good[3])
    with pytest.raises(TypeError, match="pos: expected dtype float32, got float64"):
        antialias(*good[:2], good[2].double(), good[3])
    with pytest.raises(ValueError, match="tri: expected vertex indices from 0 to 61, got 62"):
        antialias(*good[:3], torch.full((1, 3), 62, dtype=torch.int32))
    with pytest.raises(TypeError, match="topology: expected a result of antialias_construct_topology or None, got Te"):
        antialias(*good, topology=good[3])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="topology: expected the topology of the 96 triangles of tri, got one of 1"):
        antialias(*good, topology=antialias_construct_topology(good[3][:1]))
    with pytest.raises(ValueError, match="pos_gradient_boost: expected a finite number, got nan"):
        antialias(*good, pos_gradient_boost=float("nan"))
    with pytest.raises(TypeError, match=r"tri: expected dtype int32, got int64; use tri.int\(\)"):
        antialias_construct_topology(good[3].long())
