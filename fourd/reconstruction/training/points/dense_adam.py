"""Adam for the networks and planes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.rendering.ops.loading import as_array
from fourd.rendering.ops.moves import adam, has_kernels
from fourd.rendering.ops.operator import kernel_array


@dataclass(frozen=True)
class _Arrays:
    """A parameter, its moments and the number of its updates, in the memory of tensors with these addresses."""

    addresses: tuple[int, ...]
    parameter: NDArray[np.float32]
    first: NDArray[np.float32]
    second: NDArray[np.float32]
    step: NDArray[np.float32]


class DenseAdam(torch.optim.Adam):
    """:class:`torch.optim.Adam` with the same state. On the CPU, one kernel updates all parameters of all groups with
    all threads, because torch calls six operators for each parameter only to count the step. Group options other than
    the learning rate must be equal in all groups, and those of AMSGrad, weight decay and maximisation are unused."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._arrays: dict[int, _Arrays] = {}

    def step(self, closure: Callable[[], Any] | None = None) -> None:  # type: ignore[override]
        """Update the parameters that have gradients. ``closure`` must be None."""
        updated = [(group, each) for group in self.param_groups for each in group["params"] if each.grad is not None]
        gradients = [_like(each.grad, each) for _, each in updated]
        if not has_kernels(*(each for _, each in updated), *gradients):
            super().step(closure)
            return
        arrays = [self._arrays_of(each) for _, each in updated]
        for each in arrays:
            # The count is changed through its memory, because an operator on each of them takes longer than the update.
            each.step[...] += 1
        adam(
            [each.parameter for each in arrays],
            [kernel_array(gradient) for gradient in gradients],
            [each.first for each in arrays],
            [each.second for each in arrays],
            [int(each.step) for each in arrays],
            [group["lr"] for group, _ in updated],
            self.defaults["betas"],
            self.defaults["eps"],
        )

    def _arrays_of(self, parameter: Tensor) -> _Arrays:
        """Return a parameter and its state as arrays. They are kept from step to step, because converting them takes
        longer than the update."""
        state = self._state(parameter)
        tensors = (parameter, state["exp_avg"], state["exp_avg_sq"], state["step"])
        addresses = tuple(each.data_ptr() for each in tensors)
        found = self._arrays.get(id(parameter))
        if found is None or found.addresses != addresses:
            found = self._arrays[id(parameter)] = _Arrays(addresses, *(as_array(each) for each in tensors))
        return found

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
