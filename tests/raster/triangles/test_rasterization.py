"""Values and gradients of `rasterize`, compared with the reference and with finite differences."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.rasterize.op import rasterize_triangles
from fourd.rendering.triangles import DepthPeeler, rasterize
from tests.raster.triangles.scenes import soup

SIZE = (45, 70)


def values_and_gradient(
    pos: Tensor, tri: Tensor, upstream: tuple[Tensor, Tensor], backend: str, **settings: object
) -> tuple[Tensor, Tensor, Tensor]:
    """Return rast, rast_db and the gradient with respect to pos. The reference computes the gradient in float64."""
    leaf = pos.clone().requires_grad_()
    rast, rast_db = rasterize(leaf, tri, SIZE, backend=backend, **settings)  # type: ignore[arg-type]
    if backend == "reference":
        leaf = pos.double().requires_grad_()
        upstream = (upstream[0].double(), upstream[1].double())
        outputs = rasterize(leaf, tri, SIZE, backend=backend, **settings)  # type: ignore[arg-type]
    else:
        outputs = rast, rast_db
    (gradient,) = torch.autograd.grad(outputs, leaf, upstream, allow_unused=True)
    return rast.detach(), rast_db.detach(), gradient.float()


def random_upstream(rng: np.random.Generator, images: int) -> tuple[Tensor, Tensor]:
    rast, rast_db = rng.standard_normal((2, images, *SIZE, 4)).astype(np.float32)
    return torch.from_numpy(rast), torch.from_numpy(0.1 * rast_db)


def well_posed_soup(rng: np.random.Generator, behind: bool) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor]]:
    """Return a soup, and random gradients of its images, for which float32 gives the gradient with respect to the
    positions. One soup in 500 shows a triangle so nearly edge-on that the reference in float32 is wrong, too."""
    while True:
        pos, tri = soup(rng, behind=behind)
        upstream = random_upstream(rng, len(pos))
        true = values_and_gradient(pos, tri, upstream, "reference")[2]
        leaf = pos.clone().requires_grad_()
        (rounded,) = torch.autograd.grad(rasterize(leaf, tri, SIZE, backend="reference"), leaf, upstream)
        if float((rounded - true).abs().max()) < 1e-4 * float(true.abs().max()):
            return pos, tri, upstream


def assert_close(found: tuple[Tensor, ...], expected: tuple[Tensor, ...]) -> None:
    rast, rast_db, gradient = found
    assert torch.equal(rast[..., 2:], expected[0][..., 2:])
    assert_close_except_slivers(rast, expected[0], rtol=0, atol=1e-5)
    assert_close_except_slivers(rast_db, expected[1], rtol=1e-4, atol=1e-5 * float(expected[1].abs().max()))
    torch.testing.assert_close(gradient, expected[2], rtol=1e-3, atol=3e-4 * float(expected[2].abs().max()))


def assert_close_except_slivers(found: Tensor, expected: Tensor, rtol: float, atol: float) -> None:
    """Compare two tensors in float32. In the pixels of triangles that are seen almost edge-on, both tensors have large
    rounding errors. One of 1,000 numbers may therefore differ by up to 30 times the tolerance ``atol``."""
    error = (found - expected).abs() - rtol * expected.abs()
    assert float(torch.quantile(error.flatten(), 0.999)) <= atol
    assert float(error.max()) <= 30 * atol


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize("behind", [False, True])
def test_kernel_equals_the_reference(
    simd: str, behind: bool, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches wrong interpolation planes, wrong signs of gradients and pixels that are skipped at the borders of tiles.
    Depths and ids must have the same bits as those of the reference.
    """
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    pos, tri, upstream = well_posed_soup(rng, behind)
    expected = values_and_gradient(pos, tri, upstream, "reference")
    assert float((expected[0][..., 3] > 0).float().mean()) > 0.2
    assert_close(values_and_gradient(pos, tri, upstream, "cpu"), expected)


@pytest.mark.parametrize("behind", [False, True])
def test_gpu_equals_the_cpu(
    behind: bool, gpu: torch.device, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches images whose bits depend on the backend, also behind the first layer and in range mode, and gradients
    that are not cleared."""
    pos, tri = soup(rng, triangles=30, behind=behind)
    pos[:, :20, :2] *= 0.2  # Small and large triangles have separate kernels.
    upstream = random_upstream(rng, len(pos))
    ranges = torch.tensor([[5, 20], [0, 7]], dtype=torch.int32)

    def results(device: torch.device) -> list[Tensor]:
        on_device = [values.to(device) for values in (pos, tri, *upstream)]
        found = [*values_and_gradient(on_device[0], on_device[1], (on_device[2], on_device[3]), "auto")]
        with DepthPeeler(on_device[0][0], on_device[1], SIZE, ranges=ranges) as peeler:
            found += [value for _ in range(3) for value in peeler.rasterize_next_layer()]
        return [value.cpu() for value in found]

    found = results(gpu)
    monkeypatch.delenv("FOURD_SIMD", raising=False)
    expected = results(torch.device("cpu"))
    torch.testing.assert_close(found[2], expected[2], rtol=1e-3, atol=1e-4 * float(expected[2].abs().max()))
    assert all(torch.equal(found[k], expected[k]) for k in range(len(found)) if k != 2)


def test_range_mode_equals_the_reference(rng: np.random.Generator) -> None:
    """Catches ids that are counted from the start of the range, and gradients that are not summed over images."""
    pos, tri = soup(rng, images=1)
    ranges = torch.tensor([[0, 20], [15, 45], [60, 0], [3, 1]], dtype=torch.int32)
    upstream = random_upstream(rng, len(ranges))
    expected = values_and_gradient(pos[0], tri, upstream, "reference", ranges=ranges)
    assert_close(values_and_gradient(pos[0], tri, upstream, "cpu", ranges=ranges), expected)
    assert not expected[0][2].any()


@pytest.mark.parametrize("behind", [False, True])
def test_gradient_equals_finite_differences(behind: bool, rng: np.random.Generator) -> None:
    """Catches an error that kernel and reference have in common. Pixels whose triangle changes are excluded."""
    size, covered = (20, 24), 0.0
    while covered < 0.3:
        pos, tri = soup(rng, images=1, vertices=8, triangles=6, behind=behind)
        covered = float((rasterize(pos, tri, size)[0][..., 3] > 0).float().mean())
    weights = [upstream.double() for upstream in random_upstream(rng, 1)]
    step = 1e-5
    weights = [weight[:, : size[0], : size[1]] for weight in weights]

    def outputs(at: Tensor) -> tuple[Tensor, Tensor]:
        return rasterize(at, tri, size, backend="reference")

    checked = 0
    for index in np.ndindex(8, 4):
        offset = torch.zeros(1, 8, 4, dtype=torch.float64)
        offset[(0, *index)] = step
        low, high = outputs(pos.double() - offset), outputs(pos.double() + offset)
        leaf = pos.clone().requires_grad_()
        middle = rasterize(leaf, tri, size)
        steady = (low[0][..., 3] == high[0][..., 3]) & (low[0][..., 3] == middle[0][..., 3])
        # Where u or v is clamped in one of the images, the slope is not defined.
        inside = [(o[0][..., 0] > 0) & (o[0][..., 1] > 0) & (o[0][..., :2].sum(-1) < 1 - 1e-7) for o in (low, high)]
        mask = (steady & inside[0] & inside[1])[..., None].double()
        slope = sum(
            float((mask * weight * (b - a))[..., :4][..., : 2 if k == 0 else 4].sum()) / (2 * step)
            for k, (weight, a, b) in enumerate(zip(weights, low, high, strict=True))
        )
        upstream = [(mask * weight).float() for weight in weights]
        gradient = torch.autograd.grad(middle, leaf, upstream)[0]
        assert float(gradient[(0, *index)]) == pytest.approx(slope, rel=2e-3, abs=2e-3), index
        checked += slope != 0
    assert checked >= 6


def test_depth_and_id_have_no_gradient(rng: np.random.Generator) -> None:
    """Catches gradients through z/w, and a gradient of rast_db that grad_db=False does not switch off."""
    pos, tri = soup(rng)
    leaf = pos.clone().requires_grad_()
    rast, rast_db = rasterize(leaf, tri, SIZE, grad_db=False)
    assert not torch.autograd.grad(rast[..., 2:].sum(), leaf, retain_graph=True)[0].any()
    (through_db,) = torch.autograd.grad(rast_db.sum(), leaf, retain_graph=True, allow_unused=True)
    assert through_db is None
    upstream = random_upstream(rng, len(pos))
    both = torch.autograd.grad((rast, rast_db), leaf, upstream)[0]
    alone = values_and_gradient(pos, tri, (upstream[0], torch.zeros_like(upstream[1])), "cpu")[2]
    torch.testing.assert_close(both, alone, rtol=1e-4, atol=1e-4 * float(alone.abs().max()))


def test_derivatives_can_be_left_out(rng: np.random.Generator) -> None:
    """Catches values of rast that change if rast_db is not computed, and a backward pass that reads a missing
    gradient."""
    pos, tri = soup(rng)
    leaf = pos.clone().requires_grad_()
    rast, rast_db = rasterize(leaf, tri, SIZE, output_db=False)
    assert rast_db.shape == (2, *SIZE, 0)
    assert torch.equal(rast, rasterize(pos, tri, SIZE)[0])
    assert torch.autograd.grad(rast[..., 0].sum(), leaf)[0].any()


def test_any_number_of_threads_gives_the_same_bits(rng: np.random.Generator) -> None:
    """Catches sums whose order depends on the threads, and partial sums that are merged in the wrong order."""
    pos, tri = soup(rng, images=3, vertices=200, triangles=3000)
    results = []
    for threads in (1, 2, 5):
        leaf = pos.clone().requires_grad_()
        rast, rast_db = rasterize(leaf, tri, SIZE, threads=threads)
        gradient = torch.autograd.grad(rast[..., :2].sum() + (rast_db**2).sum(), leaf)[0]
        results.append((rast, rast_db, gradient))
    for other in results[1:]:
        assert all(torch.equal(one, two) for one, two in zip(results[0], other, strict=True))


def test_any_instruction_set_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches fused multiplications, which would move the borders between intersecting triangles."""
    pos, tri = soup(rng, vertices=200, triangles=1000)
    results = []
    for simd in ("baseline", "avx2", "avx512"):
        if not load_native().simd_available(simd):
            continue
        monkeypatch.setenv("FOURD_SIMD", simd)
        leaf = pos.clone().requires_grad_()
        rast, rast_db = rasterize(leaf, tri, SIZE)
        gradient = torch.autograd.grad(rast[..., :2].sum() + (rast_db**2).sum(), leaf)[0]
        results.append((rast, rast_db, gradient))
    for other in results[1:]:
        assert all(torch.equal(one, two) for one, two in zip(results[0], other, strict=True))


def test_vertices_that_are_not_finite_are_culled(rng: np.random.Generator) -> None:
    """Catches NaN in images, and in the gradients of other vertices."""
    pos, tri = soup(rng, images=1)
    good = pos.clone()
    bad = torch.tensor([3, 7, 11, 20])
    for vertex, value in zip(bad.tolist(), [torch.nan, torch.inf, -torch.inf, torch.nan], strict=True):
        pos[0, vertex, vertex % 4] = value
    touched = torch.isin(tri, bad.int()).any(1)
    assert touched.any()
    upstream = random_upstream(rng, 1)
    found = values_and_gradient(pos, tri, upstream, "cpu")
    hidden = tri.clone()
    hidden[touched] = 0  # A degenerate triangle covers nothing.
    expected = values_and_gradient(good, hidden, upstream, "cpu")
    assert all(torch.equal(one, other) for one, other in zip(found, expected, strict=True))


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 1, 0)])
def test_clipped_polygons_that_become_concave_stay_in_their_arrays(
    order: tuple[int, int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a clipped polygon with more corners than its array has space for. Fuzzing found these vertices, whose
    coordinates differ so much that rounding makes the polygon concave."""
    pos = torch.tensor(
        [
            [6.91540652e-18, 9.5149578e14, -59.0862732, -1.32508486e-17],
            [6.85660459e-13, 7.16866683e14, 9.5149578e14, 1.75120866e18],
            [2.85226337e32, -1.85342221e38, -2.15559502e38, 9.51492157e14],
        ]
    )
    tri = torch.tensor([order], dtype=torch.int32)
    expected = rasterize(pos[None], tri, (2, 2), backend="cpu")
    assert all(torch.isfinite(each).all() for each in expected)
    if importlib.util.find_spec("fourd._emulated") is not None:
        monkeypatch.setenv("FOURD_SIMD", "emulated")
        found = rasterize(pos[None], tri, (2, 2), backend="cpu")
        assert all(torch.equal(one, other) for one, other in zip(found, expected, strict=True))


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("counts", [(0, 40, 60), (2, 0, 0), (2, 40, 0)])
def test_empty_meshes_give_the_background(backend: str, counts: tuple[int, int, int]) -> None:
    """Catches crashes for inputs without images, vertices or triangles."""
    images, vertices, triangles = counts
    pos = torch.ones(images, vertices, 4, requires_grad=True)
    tri = torch.zeros(triangles, 3, dtype=torch.int32)
    rast, rast_db = rasterize(pos, tri, SIZE, backend=backend)
    assert rast.shape == rast_db.shape == (images, *SIZE, 4)
    assert not rast.any()
    if backend == "cpu":
        assert torch.autograd.grad(rast.sum(), pos)[0].shape == pos.shape


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a wrong fake implementation, and an operator that changes its inputs or returns one of them."""
    pos, tri = soup(rng, images=1, triangles=10)
    pos.requires_grad_()
    previous = rasterize(pos, tri, SIZE)[0].detach()
    ranges = torch.tensor([[2, 5]], dtype=torch.int32)
    for optional in ((None, None, True), (ranges, previous, False)):
        torch.library.opcheck(rasterize_triangles.defined, (pos, tri, *optional[:2], *SIZE, optional[2], True, 0))


def test_wrong_arguments_are_named(rng: np.random.Generator) -> None:
    """Catches out-of-range reads and unclear errors."""
    pos, tri = soup(rng)
    with pytest.raises(ValueError, match=r"pos: expected shape \(B, V, 4\), got \(2, 40, 3\)"):
        rasterize(pos[..., :3], tri, SIZE)
    with pytest.raises(ValueError, match="tri: expected vertex indices from 0 to 39, got 40"):
        rasterize(pos, torch.tensor([[0, 40, 1]], dtype=torch.int32), SIZE)
    with pytest.raises(TypeError, match=r"tri: expected dtype int32, got int64; use tri\.int\(\)"):
        rasterize(pos, tri.long(), SIZE)
    with pytest.raises(TypeError, match="pos: expected dtype float32 for backend 'auto', got float64"):
        rasterize(pos.double(), tri, SIZE)
    with pytest.raises(ValueError, match="resolution: expected sides from 1 to 32768 pixels"):
        rasterize(pos, tri, (10, 40000))
    with pytest.raises(ValueError, match=r"ranges: expected .* within the 60 triangles of tri, got \(50, 11\)"):
        rasterize(pos[0], tri, SIZE, ranges=torch.tensor([[50, 11]], dtype=torch.int32))
    with pytest.raises(ValueError, match=r"pos: expected shape \(V, 4\), got \(2, 40, 4\)"):
        rasterize(pos, tri, SIZE, ranges=torch.tensor([[0, 1]], dtype=torch.int32))


def test_images_of_triangles_without_vertices_have_no_gradient() -> None:
    """Catches reads past the end of the positions, if a caller passes an image that the rasterizer did not draw."""
    pos, grad_pos = np.ones((1, 3, 4), np.float32), np.ones((1, 3, 4), np.float32)
    tri = np.array([[0, 1, 2**30], [-1, 1, 2]], np.int32)
    rast, upstream = np.ones((1, 4, 4, 4), np.float32), np.ones((1, 4, 4, 4), np.float32)
    rast[:, 2:, :, 3] = 2
    load_native().rasterize_triangles_backward(pos, tri, None, rast, 1, "baseline", upstream, upstream, grad_pos)
    assert not grad_pos.any()
