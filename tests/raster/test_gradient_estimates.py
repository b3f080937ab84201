"""Stochastic gradient estimates compared with autograd."""

from __future__ import annotations

from itertools import product

import pytest
import torch
from torch import Tensor

from fourd.rendering.triangles import estimate_gradient

IDS = torch.tensor([[0, 1], [2, 2], [-1, 0]])
TARGET = torch.tensor([[0.2, 0.8], [0.1, 0.4], [0.7, 0.5]], dtype=torch.float64)


def render(params: Tensor) -> Tensor:
    """An image in which each pixel is a * (b + 1), where a and b are the two parameters of the pixel's primitive."""
    values = params[:, 0] * (params[:, 1] + 1)
    return torch.where(IDS >= 0, values[IDS.clamp(min=0)], 0)


def loss(image: Tensor) -> Tensor:
    return (image - TARGET) ** 2


def exact(params: Tensor) -> Tensor:
    leaf = params.clone().requires_grad_()
    return torch.autograd.grad(loss(render(leaf)).sum(), leaf)[0]


def test_expectation_is_the_gradient_of_autograd(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a wrong sign or scale. The mean over all 64 sign patterns is the expectation."""
    params = torch.tensor([[0.3, 0.2], [0.9, -0.4], [0.5, 0.6]], dtype=torch.float64)
    patterns = [torch.tensor(bits).reshape(3, 2) for bits in product((0, 1), repeat=6)]
    queue = iter(patterns)
    monkeypatch.setattr(torch, "randint", lambda *_, **__: next(queue))
    found = estimate_gradient(render, loss, params, lambda _: IDS, epsilon=1e-4, samples=len(patterns))
    torch.testing.assert_close(found, exact(params), rtol=1e-5, atol=1e-7)


def test_generator_repeats_the_estimate_and_samples_reduce_its_noise() -> None:
    """Catches random signs that ignore the generator, and samples that are not averaged."""
    params = torch.tensor([[0.3, 0.2], [0.9, -0.4], [0.5, 0.6]], dtype=torch.float64)

    def estimate(samples: int) -> Tensor:
        generator = torch.Generator().manual_seed(3)
        settings = {"epsilon": 1e-3, "samples": samples, "generator": generator}
        return estimate_gradient(render, loss, params, lambda _: IDS, **settings)  # type: ignore[arg-type]

    assert torch.equal(estimate(5), estimate(5))
    torch.testing.assert_close(estimate(4000), exact(params), rtol=0.1, atol=0.05)


def test_pixels_credit_only_what_they_show_in_either_image() -> None:
    """Catches a pixel whose loss difference is added to a primitive that the pixel does not show. Also catches a loss
    difference that is added twice to a primitive that the pixel shows in both images. Also catches a pixel that ignores
    the primitive of the second image. In the second image, primitive 1 replaces primitive 0 in one pixel.
    """
    params = torch.zeros(3, 1, dtype=torch.float64)
    calls = iter([torch.tensor([[0, 0]]), torch.tensor([[1, 0]])])
    images = iter([torch.tensor([[3.0, 5.0]]), torch.tensor([[1.0, 1.0]])])
    found = estimate_gradient(
        lambda _: next(images).double(), lambda image: image, params, lambda _: next(calls), epsilon=0.5
    )
    assert found[:, 0].abs().tolist() == [6.0, 2.0, 0.0]


def test_several_ids_in_a_pixel_and_epsilon_for_each_parameter() -> None:
    """Catches a last axis of ids that is read as pixels, and one epsilon that is used for all parameters."""
    params = torch.zeros(4, 2, dtype=torch.float64)
    epsilon = torch.tensor([0.5, 0.25], dtype=torch.float64)
    images = iter([torch.tensor([2.0, 0.0]), torch.tensor([1.0, 0.0])])
    ids = torch.tensor([[0, 2, -1], [1, 1, 1]])
    found = estimate_gradient(lambda _: next(images).double(), lambda x: x, params, lambda _: ids, epsilon=epsilon)
    assert found.abs().tolist() == [[1.0, 2.0], [0.0, 0.0], [1.0, 2.0], [0.0, 0.0]]


def test_invalid_arguments_are_named() -> None:
    """Catches wrong gradients, without an error, for ids of another size than the image and for perturbations of size
    0.
    """
    params = torch.zeros(3, 2)

    def call(ids: Tensor = IDS, epsilon: float = 0.1, samples: int = 1, values: Tensor = params) -> None:
        estimate_gradient(render, loss, values, lambda _: ids, epsilon=epsilon, samples=samples)

    with pytest.raises(ValueError, match="epsilon: expected values greater than 0, got 0"):
        call(epsilon=0)
    with pytest.raises(ValueError, match="samples: expected at least 1, got 0"):
        call(samples=0)
    with pytest.raises(TypeError, match="params: expected a floating-point tensor"):
        call(values=torch.zeros(3, dtype=torch.int32))
    with pytest.raises(ValueError, match=r"ids: expected the shape of the losses, \(3, 2\), .*, got \(2, 2\)"):
        call(ids=IDS[:2])
    with pytest.raises(ValueError, match="ids: expected primitives below 3, got 3"):
        call(ids=IDS + 1)
    with pytest.raises(TypeError, match="ids: expected integers, got float32"):
        call(ids=IDS.float())
