"""Gradients of texture lookups compared with finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.triangles import texture
from tests.ops.texture.inputs import BOUNDARIES, FILTERS, Lookup, smooth_lookup, values_and_gradients

STEP = 1e-6


@pytest.mark.parametrize("boundary_mode", BOUNDARIES)
@pytest.mark.parametrize("filter_mode", FILTERS)
def test_every_gradient_equals_finite_differences(
    filter_mode: str, boundary_mode: str, rng: np.random.Generator
) -> None:
    """Catches errors that the gradients of the kernel and of the reference have in common, in every mode."""
    lookup = smooth_lookup(rng, boundary_mode, filter_mode)
    upstream = torch.from_numpy(rng.standard_normal((1, 1, lookup.uv.shape[2], 2)))
    single = Lookup(*(one.float() for one in lookup.tensors))
    exact = values_and_gradients(lookup, upstream, filter_mode, boundary_mode, backend="reference")[1:]
    kernel = values_and_gradients(single, upstream, filter_mode, boundary_mode)[1:]

    def total(tensors: list[Tensor]) -> Tensor:
        out = texture(*tensors, None, filter_mode, boundary_mode, backend="reference")  # type: ignore[arg-type]
        return (out * upstream).sum(-1)

    for index, name in enumerate(("tex", "uv", "uv_da", "mip_level_bias")):
        slopes = slopes_of(total, lookup.tensors, index, rng)
        for picks, slope in slopes:
            for which, gradient in (("reference", exact[index]), ("kernel", kernel[index].double())):
                scale = max(1.0, float(exact[index].abs().max()))
                difference = abs(float((gradient * picks).sum()) - slope)
                assert difference < 2e-4 * scale + 2e-3 * abs(slope), f"{which} {name}: off by {difference}"


def slopes_of(total: object, tensors: list[Tensor], index: int, rng: np.random.Generator) -> list[tuple[Tensor, float]]:
    """Return random directions in the space of one tensor, and for each direction, the central difference of the sum of
    ``total``."""
    found = []
    for _ in range(6):
        # Random signs for a random quarter of the elements.
        signs = rng.choice([-1.0, 0, 0, 1.0], tensors[index].shape)
        picks = torch.from_numpy(signs)
        ends = []
        for sign in (1, -1):
            moved = [one.clone() for one in tensors]
            moved[index] += sign * STEP * picks
            ends.append(float(total(moved).sum()))  # type: ignore[operator]
        found.append((picks, (ends[0] - ends[1]) / (2 * STEP)))
    return found


def test_nearest_has_no_gradient_of_positions(rng: np.random.Generator) -> None:
    """Catches gradients of positions that are not initialised."""
    lookup = smooth_lookup(rng, "wrap", "nearest")
    leaves = [one.float().requires_grad_() for one in lookup.tensors]
    out = texture(*leaves, filter_mode="nearest")
    found = torch.autograd.grad(out.sum(), leaves, allow_unused=True)
    assert not found[1].any()
    assert found[2] is None
    assert found[3] is None


def test_clamped_levels_have_no_gradient() -> None:
    """Catches gradients of uv_da where the level is below 0, above the last one, or undefined."""
    tex = torch.rand(1, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    footprints = torch.tensor([0.0, 1e-30, 1e-3, 10.0, 1e20, float("inf"), float("nan")])
    da = footprints[None, None, :, None].repeat(1, 1, 1, 4).requires_grad_()
    bias = torch.zeros(1, 1, 7, requires_grad=True)
    out = texture(tex, torch.full((1, 1, 7, 2), 0.3), da, bias)
    for gradient in torch.autograd.grad(out.sum(), [da, bias]):
        assert gradient.eq(0).all()
