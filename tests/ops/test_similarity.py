"""The structural similarity kernel compared with plain torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.similarity.op import _similarity, structural_similarity
from fourd.rendering.ops.similarity.reference import structural_similarity_reference


def pictures(rng: np.random.Generator, height: int, width: int, channels: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a noisy image, and the image without noise, which has smooth and constant areas."""
    rows, columns = np.mgrid[:height, :width] / 9.0
    smooth = 0.5 + 0.4 * np.sin(rows)[..., None] * np.cos(columns[..., None] + np.arange(channels))
    smooth[: height // 3] = 0.0
    noisy = np.clip(smooth + rng.normal(0, 0.1, smooth.shape), 0, 1)
    return torch.from_numpy(noisy.astype(np.float32)), torch.from_numpy(smooth.astype(np.float32))


@pytest.mark.parametrize("simd", ["baseline", "avx2"])
@pytest.mark.parametrize("shape", [(11, 11, 3), (12, 40, 1), (53, 37, 3), (90, 64, 4)])
def test_value_and_gradient_equal_the_reference(
    shape: tuple[int, int, int], simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a window that is off by one at a border, a wrong sign in the gradient, and mixed channels."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    noisy, smooth = pictures(rng, *shape)
    single = noisy.clone().requires_grad_()
    value = structural_similarity(single, smooth)
    double = noisy.double().requires_grad_()
    expected = structural_similarity_reference(double, smooth.double())
    assert value.item() == pytest.approx(expected.item(), abs=1e-5)
    found, truth = torch.autograd.grad(3 * value, single)[0], torch.autograd.grad(3 * expected, double)[0]
    assert float((found - truth).abs().max()) <= 1e-3 * float(truth.abs().max())


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a sum in an order that depends on thread scheduling. A resumed run would then not be bit-identical."""
    noisy, smooth = pictures(rng, 150, 70, 3)
    results = []
    for threads in ("1", "2", "7"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        results.append(_similarity(noisy, smooth, True))
    assert all(torch.equal(a, b) for result in results[1:] for a, b in zip(result, results[0], strict=True))


def test_inputs_without_a_kernel_use_the_reference(rng: np.random.Generator) -> None:
    """Catches a missing gradient of the target, and images smaller than the window that are accepted."""
    noisy, smooth = pictures(rng, 20, 20, 3)
    target = smooth.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(structural_similarity(noisy, target), target)
    assert float(gradient.abs().max()) > 0
    assert float(structural_similarity(noisy.double(), smooth.double())) == pytest.approx(
        float(structural_similarity(noisy, smooth)), abs=1e-5
    )
    with pytest.raises(ValueError, match="prediction: expected"):
        structural_similarity(noisy[:5], smooth[:5])


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and an operator schema that omits a mutated argument."""
    noisy, smooth = pictures(rng, 14, 13, 2)
    for with_gradient in (True, False):
        torch.library.opcheck(_similarity.defined, (noisy, smooth, with_gradient))
