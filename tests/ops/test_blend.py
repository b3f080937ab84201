"""The kernel of the blend MLP compared with plain torch: values, gradients and number of threads."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.blend.op import blend_logits
from fourd.rendering.ops.blend.reference import blend_logits_reference
from fourd.rendering.ops.loading import load_native


def arguments(
    rng: np.random.Generator, count: int, hidden: int = 64, channels: int = 11, views: int = 4
) -> list[Tensor]:
    shapes = [(count, hidden), (views, channels, count), (hidden, channels), (hidden,), (1,)]
    return [torch.from_numpy(rng.standard_normal(shape).astype(np.float32)) for shape in shapes]


def values_and_gradients(function, inputs: list[Tensor], upstream: Tensor) -> list[Tensor]:
    leaves = [tensor.clone().requires_grad_() for tensor in inputs]
    found = function(*leaves)
    return [found.detach(), *torch.autograd.grad(found, leaves, upstream.to(found))]


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize(("count", "hidden", "channels", "views"), [(300, 64, 11, 4), (2100, 20, 3, 2), (1, 1, 1, 1)])
def test_values_and_gradients_equal_the_reference(
    count: int,
    hidden: int,
    channels: int,
    views: int,
    simd: str,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Catches a transposed weight matrix, gradients that are not summed over views, and errors in the last, incomplete
    chunk of points."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    inputs = arguments(rng, count, hidden, channels, views)
    upstream = torch.from_numpy(rng.standard_normal((views, count)).astype(np.float32))
    found = values_and_gradients(blend_logits, inputs, upstream)
    expected = values_and_gradients(blend_logits_reference, [tensor.double() for tensor in inputs], upstream)
    for index, (one, other) in enumerate(zip(found, expected, strict=True)):
        # The gradients of the MLP's weights are sums over points, and the terms of a sum may cancel. Rounding errors
        # are proportional to the terms.
        summed = float(upstream.norm()) if index >= 3 else 0.0
        scale = max(float(other.abs().max()), summed)
        # Because of rounding, ReLU may clamp a hidden value near 0 in only one of the two implementations.
        assert float((one - other).abs().mean()) <= 1e-5 * scale
        assert float(((one - other).abs() > 1e-3 * scale).float().mean()) <= 1e-3


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a sum over points in an order that depends on thread scheduling."""
    inputs = arguments(rng, 9000)
    upstream = torch.from_numpy(rng.standard_normal((4, 9000)).astype(np.float32))
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        results.append(values_and_gradients(blend_logits, inputs, upstream))
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_no_points_give_zero_gradients(rng: np.random.Generator) -> None:
    """Catches gradients that are not initialized if there are no points."""
    found = values_and_gradients(blend_logits, arguments(rng, 0), torch.zeros(4, 0))
    assert found[0].shape == (4, 0)
    assert all(not gradient.any() for gradient in found[1:])


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and an operator schema that omits a mutated argument."""
    leaves = [tensor.requires_grad_() for tensor in arguments(rng, 5, hidden=8, channels=3)]
    torch.library.opcheck(torch.ops.fourd.blend_logits.default, tuple(leaves))


def test_mismatched_shapes_are_named(rng: np.random.Generator) -> None:
    """Catches arguments of wrong shape that reach a kernel. The kernel would read past the end of an array."""
    point, samples, weight, out, bias = arguments(rng, 5)
    with pytest.raises(ValueError, match=r"samples: expected shape \(views, channels, points\)"):
        blend_logits(point, samples[:, :, :4], weight, out, bias)
    with pytest.raises(ValueError, match="out: expected the hidden layer's width"):
        blend_logits(point, samples, weight, out[:3], bias)
