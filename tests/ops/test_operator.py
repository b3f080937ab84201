"""Operators that are called without torch's dispatcher."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.profiler import profile

from fourd.rendering.ops.operator import operator

NEEDED: list[object] = []


@operator("fourd_test::weighted", outputs=lambda values: torch.empty_like(values), devices=("cpu",))
def weighted(values: Tensor, factor: float, weights: list[Tensor], mask: Tensor | None) -> Tensor:
    return factor * values * sum(weights) * (1 if mask is None else mask)


def _setup(ctx: Any, inputs: tuple[Tensor, float, list[Tensor], Tensor | None], output: Tensor) -> None:
    values, ctx.factor, weights, ctx.mask = inputs
    ctx.save_for_backward(values, *weights)


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, list[Tensor | None], None]:
    NEEDED.append(ctx.needs_input_grad)
    values, *weights = ctx.saved_tensors
    scaled = ctx.factor * gradient * (1 if ctx.mask is None else ctx.mask)
    needed = ctx.needs_input_grad[2]
    return scaled * sum(weights), None, [scaled * values if each else None for each in needed], None


weighted.register_autograd(_backward, setup_context=_setup)


@operator("fourd_test::doubled", outputs=lambda values: torch.empty_like(values), devices=("cpu",))
def doubled(values: Tensor) -> Tensor:
    return 2 * values.detach()


@pytest.mark.parametrize("has_mask", [False, True])
def test_the_gradient_is_that_of_the_dispatcher(has_mask: bool) -> None:
    """Catches gradients of the tensors in a list that are assigned to other arguments."""
    values, first, second, fixed, mask = torch.rand(5, 4, generator=torch.Generator().manual_seed(0)).unbind()
    leaves = [each.clone().requires_grad_() for each in (values, first, second)]
    call = (leaves[0], 3.0, [leaves[1], fixed, leaves[2]], mask if has_mask else None)
    NEEDED.clear()
    direct, dispatched = weighted(*call), weighted.defined(*call)
    assert torch.equal(direct, dispatched)
    for found, expected in zip(
        torch.autograd.grad(direct.sum(), leaves), torch.autograd.grad(dispatched.sum(), leaves), strict=True
    ):
        assert torch.equal(found, expected)
    assert [list(each[2]) for each in NEEDED] == 2 * [[True, False, True]]  # type: ignore[index]


def test_a_result_without_gradient_is_not_differentiated() -> None:
    """Catches a constant where the derivative of an operator without gradient is needed."""
    values = torch.ones(3, requires_grad=True)
    with pytest.raises(RuntimeError, match="no autograd formula was registered"):
        doubled(values).sum().backward()
    with torch.no_grad():
        assert not doubled(values).requires_grad


def test_fake_tensors_and_the_profiler_see_the_operator() -> None:
    """Catches a kernel that runs on fake tensors, whose memory does not exist, and calls that the profile lacks."""
    with FakeTensorMode():
        assert doubled(torch.empty(3)).shape == (3,)
    with profile() as found:
        doubled(torch.ones(3))
    assert "fourd_test::doubled" in {event.name for event in found.events()}
