"""Sampling of source views: the CPU and CUDA kernels compared with plain torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.gpu import load_gpu
from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.points.validation import pack_camera
from fourd.rendering.ops.sources.op import _sample, sample_sources
from fourd.rendering.ops.sources.reference import sample_sources_reference
from tests.baking.scenes import ring

VIEWS, HEIGHT, WIDTH = 3, 40, 48


@dataclass(frozen=True)
class Views:
    """Images, mattes, depth maps and packed cameras of source views."""

    images: Tensor
    mattes: Tensor
    depth: Tensor | None
    cameras: list[float]

    def to(self, device: torch.device) -> Views:
        depth = None if self.depth is None else self.depth.to(device)
        return Views(self.images.to(device), self.mattes.to(device), depth, self.cameras)

    @property
    def arguments(self) -> tuple[Tensor, Tensor, Tensor | None, list[float]]:
        return self.images, self.mattes, self.depth, self.cameras


def random_views(rng: np.random.Generator, occlusion: bool) -> Views:
    """Return source views with random images that are not square. Some depths occlude points, and some depths are
    infinite."""

    def random(*shape: int) -> Tensor:
        return torch.from_numpy(rng.uniform(0, 1, shape).astype(np.float32))

    cameras = [number for camera in ring(VIEWS, HEIGHT) for number in pack_camera(replace(camera, width=WIDTH))]
    depth = 2.2 + 1.5 * random(VIEWS, HEIGHT, WIDTH)
    depth[:, :, ::7] = torch.inf
    images, mattes = random(VIEWS, 3, HEIGHT, WIDTH), random(VIEWS, HEIGHT, WIDTH)
    return Views(images, mattes, depth if occlusion else None, cameras)


def make_softness(xyz: Tensor) -> Tensor:
    """Return decay lengths (N,) that are different for every point."""
    return torch.linspace(0.02, 0.3, len(xyz)).to(xyz.device)


Result = tuple[Tensor, Tensor, list[Tensor]]


def run(
    function: Callable[..., tuple[Tensor, Tensor]], xyz: Tensor, views: Views, features: Tensor | None, seed: int
) -> Result:
    """Return channels, visibility and the gradients of a random linear function of the channels, as tensors on the
    CPU."""
    leaves = [tensor.clone().requires_grad_() for tensor in (xyz, features) if tensor is not None]
    leaf = leaves[1] if features is not None else None
    channels, visibility = function(leaves[0], leaf, *views.arguments, make_softness(leaves[0]))
    weights = torch.from_numpy(np.random.default_rng(seed).normal(size=tuple(channels.shape)))
    total = (channels * weights.to(channels)).sum()
    gradients = [gradient.cpu() for gradient in torch.autograd.grad(total, leaves)]
    return channels.detach().cpu(), visibility.cpu(), gradients


def random_features(rng: np.random.Generator, channels: int) -> Tensor | None:
    """Return random features at half the resolution of the images, or None for 0 channels."""
    if channels == 0:
        return None
    return torch.from_numpy(rng.normal(size=(VIEWS, channels, HEIGHT // 2, WIDTH // 2)).astype(np.float32))


def assert_same(got: Result, wanted: Result) -> None:
    for value, expected in zip(got[:2], wanted[:2], strict=True):
        torch.testing.assert_close(value, expected, rtol=1e-4, atol=2e-5)
    for found, truth in zip(got[2], wanted[2], strict=True):
        # The gradient is discontinuous at the border between two texels, where rounding decides which texel applies.
        close = (found - truth).abs() <= 1e-3 * truth.abs().max()
        assert float(close.float().mean()) >= 0.995


@pytest.mark.parametrize("occlusion", [False, True])
@pytest.mark.parametrize("channels", [0, 5])
def test_gpu_equals_the_reference(channels: int, occlusion: bool, gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches samples that are shifted by half a pixel, views in the wrong order, and gradients of the wrong scale."""
    views = random_views(rng, occlusion)
    xyz = torch.from_numpy(rng.normal(0, 1.2, (400, 3)).astype(np.float32))
    features = random_features(rng, channels)
    on_gpu = None if features is None else features.to(gpu)
    got = run(sample_sources, xyz.to(gpu), views.to(gpu), on_gpu, 1)
    assert_same(got, run(sample_sources_reference, xyz, views, features, 1))


@pytest.mark.parametrize("simd", ["baseline", "avx2"])
@pytest.mark.parametrize("channels", [0, 5, 16])
def test_cpu_equals_the_reference(
    channels: int, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a loop that is correct only for 16 channels, and features in the wrong memory order."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    views = random_views(rng, True)
    xyz = torch.from_numpy(rng.normal(0, 1.2, (700, 3)).astype(np.float32))
    features = random_features(rng, channels)
    wanted = run(sample_sources_reference, xyz, views, features, 1)
    formats = (torch.contiguous_format, torch.channels_last)
    for held in (features,) if features is None else (features.contiguous(memory_format=each) for each in formats):
        assert_same(run(sample_sources, xyz, views, held, 1), wanted)


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a sum over views in an order that depends on thread scheduling. A resumed run would then not be
    bit-identical."""
    views = random_views(rng, True)
    xyz = torch.from_numpy(rng.normal(0, 0.8, (5000, 3)).astype(np.float32))
    features = random_features(rng, 16)
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        channels, visibility, gradients = run(sample_sources, xyz, views, features, 2)
        results.append([channels, visibility, *gradients])
    for result in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(result, results[0], strict=True))


def test_points_behind_and_outside_sample_nothing(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches reads outside an image, and NaN that spreads from one point to another."""
    views = random_views(rng, True).to(gpu)
    huge = torch.tensor([[np.nan, 0, 0], [np.inf, 0, 0], [0, -np.inf, 0], [3e38, 3e38, 3e38], [50, 0, 0.5], [0, 0, 0]])
    xyz = huge.float().to(gpu).requires_grad_()
    channels, visibility = sample_sources(xyz, None, *views.arguments, make_softness(xyz))
    assert bool((visibility[:, :4] == 0).all())
    assert float(channels[:, :, :4].detach().abs().max()) == 0
    (gradient,) = torch.autograd.grad(channels.sum(), xyz)
    assert bool(torch.isfinite(gradient[5]).all())


def test_operator_passes_opcheck(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a fake implementation with a wrong shape, and a gradient that is not registered with autograd."""
    views = random_views(rng, True).to(gpu)
    xyz = torch.randn(20, 3).to(gpu).requires_grad_()
    features = torch.randn(VIEWS, 2, 20, 24).to(gpu).requires_grad_()
    arguments = (xyz, features, *views.arguments, make_softness(xyz).detach())
    torch.library.opcheck(
        _sample.defined, arguments, test_utils=("test_schema", "test_faketensor", "test_autograd_registration")
    )


def test_too_many_views_are_rejected(gpu: torch.device) -> None:
    """Catches a number of views above the limit that is accepted. Cameras would then be written past the end of the
    kernel's argument.
    """
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
def test_softness_of_another_length_is_rejected(count: int, gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches reads past the end of the softness array."""
    views = random_views(rng, True).to(gpu)
    with pytest.raises(ValueError, match="softness: expected one value per point"):
        sample_sources(torch.zeros(4, 3, device=gpu), None, *views.arguments, torch.ones(count, device=gpu))
