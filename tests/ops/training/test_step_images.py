"""The kernels of the images of a training step compared with plain torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.gpu import CPU
from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.step_images.op import (
    add_background,
    clamped_error,
    convert_views,
    mean_square,
    premultiply,
    resolve_samples,
)
from fourd.rendering.ops.step_images.reference import (
    convert_views_reference,
    mean_square_reference,
    on_background,
    premultiply_reference,
    resolve_samples_reference,
)

SETS = pytest.mark.parametrize("simd", ["baseline", "avx2"])


def use(simd: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)


def make_view(rng: np.random.Generator, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    return rng.integers(0, 256, (height, width, 3), np.uint8), rng.integers(0, 256, (height, width), np.uint8)


def floats(rng: np.random.Generator, *shape: int) -> Tensor:
    return torch.from_numpy(rng.uniform(-0.2, 1.2, shape).astype(np.float32))


@SETS
def test_converted_views_have_the_bits_of_the_reference(
    simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches swapped channels, rows of a small view that are written to the wrong place, and padding that keeps old
    memory."""
    use(simd, monkeypatch)
    views = [make_view(rng, 37, 51), make_view(rng, 64, 20), make_view(rng, 1, 1)]
    for found, expected in zip(
        convert_views(views, (64, 96)), convert_views_reference(views, (64, 96), CPU), strict=True
    ):
        assert torch.equal(found, expected)
    for found, expected in zip(premultiply(*views[0]), premultiply_reference(*views[0], CPU), strict=True):
        assert torch.equal(found, expected)


@SETS
@pytest.mark.parametrize("samples", [1, 2, 3])
def test_pixels_and_their_gradients_equal_the_reference(
    samples: int, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches samples that are assigned to the wrong pixel, and a gradient of alpha that ignores the background."""
    use(simd, monkeypatch)
    inputs = floats(rng, 35 * samples, 50 * samples, 4), floats(rng, 35 * samples, 50 * samples)
    upstream = [floats(rng, 35, 50, 3), floats(rng, 35, 50), floats(rng, 35, 50, 3)]

    def gradients(function, dtype: torch.dtype, used: list[int]) -> list[Tensor]:
        leaves = [each.to(dtype).requires_grad_() for each in inputs]
        outputs = function(*leaves, [0.25, 0.5, 0.875], samples)
        loss = sum((outputs[i] * upstream[i].to(dtype)).sum() for i in used)
        return [each.detach() for each in outputs] + list(torch.autograd.grad(loss, leaves))

    for used in ([0, 1, 2], [2], [1, 2]):
        found = gradients(resolve_samples, torch.float32, used)
        for one, other in zip(found, gradients(resolve_samples_reference, torch.float64, used), strict=True):
            torch.testing.assert_close(one, other.float(), rtol=1e-5, atol=1e-6)


@SETS
@pytest.mark.parametrize(("shape", "first"), [((33, 47, 3), 0), ((70_001,), 0), ((501, 3, 16), 4), ((1, 1), 0)])
def test_mean_squares_and_their_gradients_equal_the_reference(
    shape: tuple[int, ...], first: int, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches numbers that count twice or not at all at the borders of parts, and columns that must not count."""
    use(simd, monkeypatch)
    values, truth = floats(rng, *shape), floats(rng, *shape)
    for other in (truth, None):
        ours, exact = values.clone().requires_grad_(), values.double().requires_grad_()
        found = mean_square(ours, other, first)
        expected = mean_square_reference(exact, None if other is None else other.double(), first)
        torch.testing.assert_close(found.double(), expected, rtol=1e-6, atol=0)
        (0.7 * found).backward()
        (0.7 * expected).backward()
        assert ours.grad is not None
        assert exact.grad is not None
        torch.testing.assert_close(ours.grad, exact.grad.float(), rtol=1e-5, atol=1e-9)
    assert clamped_error(values, truth) == pytest.approx(float((values.clamp(0, 1) - truth).double().square().mean()))


def test_a_background_is_added_with_the_bits_of_the_reference(rng: np.random.Generator) -> None:
    """Catches a rounding of the ground truth that depends on whether a kernel computes it."""
    rgb, alpha = floats(rng, 200, 300, 3), floats(rng, 200, 300)
    assert torch.equal(add_background(rgb, alpha, [0.1, 0.2, 0.3]), on_background(rgb, alpha, [0.1, 0.2, 0.3]))


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a sum over pixels in an order that depends on thread scheduling."""
    values, truth = floats(rng, 400, 300, 3), floats(rng, 400, 300, 3)
    found = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        found.append(float(mean_square(values, truth)))
    assert len(set(found)) == 1


def test_operators_pass_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and an operator schema that omits a mutated argument."""
    features, alpha = floats(rng, 6, 8, 4).requires_grad_(), floats(rng, 6, 8).requires_grad_()
    torch.library.opcheck(torch.ops.fourd.resolve_samples.default, (features, alpha, [0.1, 0.2, 0.3], 2))
    torch.library.opcheck(torch.ops.fourd.mean_square.default, (features, floats(rng, 6, 8, 4), 1))
