"""The kernel of the image encoder compared with plain torch: values, gradients and number of threads."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.encoder.op import SHAPES, encode_images
from fourd.rendering.ops.encoder.reference import encode_images_reference
from fourd.rendering.ops.loading import load_native


def make_weights(rng: np.random.Generator, features: int) -> list[Tensor]:
    weights = []
    for outputs, inputs, side in (*SHAPES, (features, 16, 3)):
        layer = rng.standard_normal((outputs, inputs, side, side)) * np.sqrt(2 / (inputs * side * side))
        weights += [torch.from_numpy(each.astype(np.float32)) for each in (layer, 0.2 * rng.standard_normal(outputs))]
    return weights


def make_images(rng: np.random.Generator, views: int, height: int, width: int) -> Tensor:
    return torch.from_numpy(rng.uniform(0, 1, (views, 3, height, width)).astype(np.float32))


def value_and_gradients(function, images: Tensor, weights: list[Tensor], stride: int, upstream: Tensor) -> list[Tensor]:
    free = [weight.clone().requires_grad_() for weight in weights]
    features = function(images, free, stride)
    return [features.detach(), *torch.autograd.grad((features * upstream.to(features)).sum(), free)]


def make_case(
    rng: np.random.Generator, views: int, height: int, width: int, stride: int, features: int
) -> tuple[Tensor, list[Tensor], int, Tensor]:
    """Return the arguments of :func:`value_and_gradients` after the function."""
    upstream = rng.standard_normal((views, features, height // stride, width // stride)).astype(np.float32)
    return make_images(rng, views, height, width), make_weights(rng, features), stride, torch.from_numpy(upstream)


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize(
    ("views", "height", "width", "stride", "features"),
    [(3, 48, 80, 2, 8), (2, 36, 20, 1, 5), (1, 8, 8, 2, 17), (2, 4, 4, 1, 1), (1, 4, 52, 1, 8), (1, 52, 4, 1, 8)],
)
def test_values_and_gradients_equal_the_reference(
    views: int,
    height: int,
    width: int,
    stride: int,
    features: int,
    simd: str,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Catches a wrong sample at the border of a map, padding that is not zero, swapped phases of a convolution with
    stride 2, a wrong mask of a ReLU, and errors in the last, incomplete vector or band of rows."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    images, weights, stride, upstream = make_case(rng, views, height, width, stride, features)
    found = value_and_gradients(encode_images, images, weights, stride, upstream)
    exact = [weight.double() for weight in weights]
    expected = value_and_gradients(encode_images_reference, images.double(), exact, stride, upstream)
    for index, (one, other) in enumerate(zip(found, expected, strict=True)):
        # A gradient is a sum over pixels whose terms may cancel. Rounding errors are proportional to the terms.
        scale = max(float(other.abs().max()), 0.1 * upstream[:, 0].numel() ** 0.5 if index else 0.0)
        assert float((one - other).abs().max()) <= 2e-5 * scale, index


@pytest.mark.parametrize(
    ("views", "height", "width", "stride", "features"), [(2, 16, 24, 2, 8), (1, 12, 8, 1, 3), (1, 4, 4, 1, 9)]
)
def test_cuda_kernel_equals_the_reference(
    views: int, height: int, width: int, stride: int, features: int, gpu: torch.device, rng: np.random.Generator
) -> None:
    """Catches a wrong sample at the border of a map, a wrong mask of a ReLU, and gradients of two layers that are
    written to the same array."""
    images, weights, stride, upstream = make_case(rng, views, height, width, stride, features)
    on_device = [weight.to(gpu) for weight in weights]
    found = value_and_gradients(encode_images, images.to(gpu), on_device, stride, upstream.to(gpu))
    exact = [weight.double() for weight in weights]
    expected = value_and_gradients(encode_images_reference, images.double(), exact, stride, upstream)
    for index, (one, other) in enumerate(zip(found, expected, strict=True)):
        scale = max(float(other.abs().max()), 0.1 * upstream[:, 0].numel() ** 0.5 if index else 0.0)
        assert float((one.cpu() - other).abs().max()) <= 2e-5 * scale, index


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a sum over pixels in an order that depends on thread scheduling."""
    case = make_case(rng, 4, 96, 112, 2, 8)
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        results.append(value_and_gradients(encode_images, *case))
    for other in results[1:]:
        assert all(torch.equal(one, two) for one, two in zip(results[0], other, strict=True))


def test_images_in_several_groups_give_the_values_of_single_images(rng: np.random.Generator) -> None:
    """Catches maps of one group of images that are read for another: large images are processed one after another."""
    images, weights, stride, upstream = make_case(rng, 3, 640, 704, 1, 8)
    found = value_and_gradients(encode_images, images, weights, stride, upstream)
    single = [
        value_and_gradients(encode_images, images[i : i + 1], weights, stride, upstream[i : i + 1]) for i in range(3)
    ]
    assert torch.equal(found[0], torch.cat([each[0] for each in single]))
    for one, *others in zip(found[1:], *(each[1:] for each in single), strict=True):
        expected = torch.stack(others).double().sum(dim=0)
        torch.testing.assert_close(one.double(), expected, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))


def test_values_without_a_gradient_are_the_same(rng: np.random.Generator) -> None:
    """Catches a forward pass that depends on whether it keeps its maps for the gradient, and features that are not
    stored pixel by pixel, which the kernel that samples them would have to copy."""
    images, weights, stride, upstream = make_case(rng, 2, 40, 72, 2, 8)
    with torch.no_grad():
        features = encode_images(images, [weight.requires_grad_() for weight in weights], stride)
    assert torch.equal(features, value_and_gradients(encode_images, images, weights, stride, upstream)[0])
    assert features.is_contiguous(memory_format=torch.channels_last)


def test_no_images_give_zero_gradients(rng: np.random.Generator) -> None:
    """Catches gradients of weights that are not initialised if there are no images."""
    features, *gradients = value_and_gradients(encode_images, *make_case(rng, 0, 8, 16, 2, 8))
    assert features.shape == (0, 8, 4, 8)
    assert not any(gradient.any() for gradient in gradients)


def test_images_with_a_gradient_use_the_reference(rng: np.random.Generator) -> None:
    """Catches a gradient of the images that is silently lost, because the kernel does not compute it."""
    images, weights = make_images(rng, 1, 8, 8).requires_grad_(), make_weights(rng, 3)
    encode_images(images, weights, 2).sum().backward()
    assert images.grad is not None
    assert images.grad.abs().max() > 0


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and an operator schema that omits a mutated argument."""
    weights = [weight.requires_grad_() for weight in make_weights(rng, 3)]
    torch.library.opcheck(torch.ops.fourd.encode_images.default, (make_images(rng, 2, 8, 16), weights, 2, True))


def test_mismatched_shapes_are_named(rng: np.random.Generator) -> None:
    """Catches arguments of wrong shape that reach a kernel. The kernel would read past the end of an array."""
    images, weights = make_images(rng, 1, 8, 16), make_weights(rng, 3)
    with pytest.raises(ValueError, match="images: expected"):
        encode_images(images[:, :, :, :12], weights, 2)
    with pytest.raises(ValueError, match="weights: expected the shapes"):
        encode_images(images, [*weights[:3], weights[3][:5], *weights[4:]], 2)
