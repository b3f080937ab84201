"""Source views sampled by the kernels, on the CPU and on a GPU or emulated, against plain torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.model.sources import SourceSamples, SourceViews, sample_sources, sample_sources_reference
from fourd.ops.gpu import load_gpu
from fourd.ops.loading import native
from fourd.ops.points.validation import pack_camera
from fourd.ops.sources.op import sample
from tests.baking.scenes import ring

VIEWS, SIZE = 3, 40


def views(rng: np.random.Generator, occlusion: bool) -> SourceViews:
    """Random pictures whose sides differ; depths some of which hide points, and some infinite."""

    def random(*shape: int) -> Tensor:
        return torch.from_numpy(rng.uniform(0, 1, shape).astype(np.float32))

    cameras = tuple(replace(camera, width=SIZE + 8) for camera in ring(VIEWS, SIZE))
    depth = 2.2 + 1.5 * random(VIEWS, SIZE, SIZE + 8)
    depth[:, :, ::7] = torch.inf
    images, mattes = random(VIEWS, 3, SIZE, SIZE + 8), random(VIEWS, SIZE, SIZE + 8)
    return SourceViews(images, mattes, depth if occlusion else None, cameras)


def moved(sources: SourceViews, device: torch.device) -> SourceViews:
    depth = None if sources.depth is None else sources.depth.to(device)
    return replace(sources, images=sources.images.to(device), mattes=sources.mattes.to(device), depth=depth)


def softness(xyz: Tensor) -> Tensor:
    """(N,) that differ from point to point."""
    return torch.linspace(0.02, 0.3, len(xyz)).to(xyz.device)


def run(
    function: Callable[..., SourceSamples], xyz: Tensor, sources: SourceViews, features: Tensor | None, seed: int
) -> tuple[SourceSamples, list[Tensor]]:
    leaves = [tensor.clone().requires_grad_() for tensor in (xyz, features) if tensor is not None]
    samples = function(leaves[0], sources, leaves[1] if features is not None else None, softness(leaves[0]))
    weights = torch.from_numpy(np.random.default_rng(seed).normal(size=tuple(samples.channels.shape)))
    total = (samples.channels * weights.to(samples.channels)).sum()
    return samples, [gradient.cpu() for gradient in torch.autograd.grad(total, leaves)]


def random_features(rng: np.random.Generator, channels: int) -> Tensor | None:
    """At half the pictures' resolution; None for no channels."""
    if channels == 0:
        return None
    return torch.from_numpy(rng.normal(size=(VIEWS, channels, SIZE // 2, (SIZE + 8) // 2)).astype(np.float32))


def assert_same(got: tuple[SourceSamples, list[Tensor]], wanted: tuple[SourceSamples, list[Tensor]]) -> None:
    """Samples, trust and gradients of :func:`run`."""
    channels, expected = got[0].channels.detach().cpu(), wanted[0].channels.detach()
    torch.testing.assert_close(channels, expected, rtol=1e-4, atol=2e-5)
    torch.testing.assert_close(got[0].trust.cpu(), wanted[0].trust, rtol=1e-4, atol=2e-5)
    for found, truth in zip(got[1], wanted[1], strict=True):
        # Where a pixel falls on the seam between samples, rounding decides which slope counts.
        close = (found - truth).abs() <= 1e-3 * truth.abs().max()
        assert float(close.float().mean()) >= 0.995


@pytest.mark.parametrize("occlusion", [False, True])
@pytest.mark.parametrize("channels", [0, 5])
def test_values_and_gradients_equal_the_reference(
    channels: int, occlusion: bool, gpu: torch.device, rng: np.random.Generator
) -> None:
    """Catches samples half a pixel off, views in another order, and a gradient at another resolution's scale."""
    sources = views(rng, occlusion)
    xyz = torch.from_numpy(rng.normal(0, 1.2, (400, 3)).astype(np.float32))
    features = random_features(rng, channels)
    on_gpu = None if features is None else features.to(gpu)
    got = run(sample_sources, xyz.to(gpu), moved(sources, gpu), on_gpu, 1)
    assert_same(got, run(sample_sources_reference, xyz, sources, features, 1))


@pytest.mark.parametrize("simd", ["baseline", "avx2"])
@pytest.mark.parametrize("channels", [0, 5, 16])
def test_the_cpu_equals_the_reference(
    channels: int, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a loop that is right for 16 channels alone, and features read in another order than they lie in."""
    if not native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    sources = views(rng, True)
    xyz = torch.from_numpy(rng.normal(0, 1.2, (700, 3)).astype(np.float32))
    features = random_features(rng, channels)
    wanted = run(sample_sources_reference, xyz, sources, features, 1)
    orders = (torch.contiguous_format, torch.channels_last)
    for held in (features,) if features is None else (features.contiguous(memory_format=order) for order in orders):
        assert_same(run(sample_sources, xyz, sources, held, 1), wanted)


def test_any_number_of_threads_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches sums over views in the order in which threads happen to end: a run could not be resumed bit by bit."""
    sources = views(rng, True)
    xyz = torch.from_numpy(rng.normal(0, 0.8, (5000, 3)).astype(np.float32))
    features = torch.from_numpy(rng.normal(size=(VIEWS, 16, 20, 24)).astype(np.float32))
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        samples, gradients = run(sample_sources, xyz, sources, features, 2)
        results.append([samples.channels.detach(), samples.trust, *gradients])
    for result in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(result, results[0], strict=True))


def test_points_behind_and_beyond_stay_out(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches reads outside a map, and NaN that spreads from one point to another."""
    sources = moved(views(rng, True), gpu)
    huge = torch.tensor([[np.nan, 0, 0], [np.inf, 0, 0], [0, -np.inf, 0], [3e38, 3e38, 3e38], [50, 0, 0.5], [0, 0, 0]])
    xyz = huge.float().to(gpu).requires_grad_()
    samples = sample_sources(xyz, sources, None, softness(xyz))
    assert bool((samples.trust[:, :4] == 0).all())
    assert float(samples.channels[:, :4].detach().abs().max()) == 0
    (gradient,) = torch.autograd.grad(samples.channels.sum(), xyz)
    assert bool(torch.isfinite(gradient[5]).all())


def test_operators_keep_torch_s_rules(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a fake implementation of another shape, and a gradient that autograd does not know."""
    sources = moved(views(rng, True), gpu)
    cameras = [number for camera in sources.cameras for number in pack_camera(camera)]
    xyz = torch.randn(20, 3).to(gpu).requires_grad_()
    features = torch.randn(VIEWS, 2, 20, 24).to(gpu).requires_grad_()
    arguments = (xyz, features, sources.images, sources.mattes, sources.depth, cameras, softness(xyz).detach())
    torch.library.opcheck(
        sample, arguments, test_utils=("test_schema", "test_faketensor", "test_autograd_registration")
    )


def test_too_many_views_are_refused(gpu: torch.device) -> None:
    """Catches cameras written past the kernel's argument."""
    many = torch.zeros(17, 3, 4, 4, device=gpu)
    with pytest.raises(ValueError, match="images: expected at most 16 views on a GPU"):
        load_gpu(gpu).kernels.sample_sources(
            torch.zeros(1, 3, device=gpu),
            many,
            many[:, 0].contiguous(),
            None,
            None,
            [0.0] * 21 * 17,
            torch.ones(1, device=gpu),
            0,
            torch.zeros(17, 3, 1, device=gpu),
            torch.zeros(17, 1, device=gpu),
        )


@pytest.mark.parametrize("count", [3, 5])
def test_a_softness_that_is_not_a_point_s_is_refused(count: int, gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches reads beyond the widths that were given."""
    sources = moved(views(rng, True), gpu)
    with pytest.raises(ValueError, match="softness: expected one a point"):
        sample_sources(torch.zeros(4, 3, device=gpu), sources, None, torch.ones(count, device=gpu))
