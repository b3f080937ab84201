"""Adam for the networks and planes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.loading import as_array
from fourd.rendering.ops.moves import adam, has_kernels


class DenseAdam(torch.optim.Adam):
    """:class:`torch.optim.Adam` with the same state. On the CPU, one kernel updates all parameters of all groups with
    all threads, because torch calls six operators for each parameter only to count the step. Group options other than
    the learning rate must be equal in all groups, and those of AMSGrad, weight decay and maximisation are unused."""

    def step(self, closure: Callable[[], Any] | None = None) -> None:  # type: ignore[override]
        """Update the parameters that have gradients. ``closure`` must be None."""
        updated = [(group, each) for group in self.param_groups for each in group["params"] if each.grad is not None]
        gradients = [_like(each.grad, each) for _, each in updated]
        if not has_kernels(*(each for _, each in updated), *gradients):
            super().step(closure)
            return
        states = [self._state(each) for _, each in updated]
        for state in states:
            # The count is changed through its memory, because an operator on each of them takes longer than the update.
            as_array(state["step"])[...] += 1
        with torch.no_grad():
            adam(
                [each for _, each in updated],
                gradients,
                [(state["exp_avg"], state["exp_avg_sq"]) for state in states],
                [int(as_array(state["step"])) for state in states],
                [group["lr"] for group, _ in updated],
                self.defaults["betas"],
                self.defaults["eps"],
            )

    def _state(self, parameter: Tensor) -> dict[str, Tensor]:
        """Return the state of a parameter, with the names that torch uses."""
        state = self.state[parameter]
        if not state:
            state["step"] = torch.tensor(0.0)
            state["exp_avg"] = torch.zeros_like(parameter)
            state["exp_avg_sq"] = torch.zeros_like(parameter)
        return state


def _like(gradient: Tensor, parameter: Tensor) -> Tensor:
    """Return the gradient in the parameter's memory format."""
    return gradient if gradient.stride() == parameter.stride() else gradient.contiguous()
