"""Definition of torch operators."""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from typing import Any

import torch
from torch import Tensor
from torch.library import CustomOpDef


def uninitialised(like: Tensor, *shape: int) -> Tensor:
    """Return a tensor with the dtype and the device of another, whose values are not set. In contrast to
    ``Tensor.new_empty`` and ``torch.empty_like``, this calls a single operator."""
    return torch.empty(shape, dtype=like.dtype, device=like.device)


def operator(
    name: str, *, outputs: Callable[..., Any], devices: tuple[str, ...] = ("cpu", "cuda")
) -> Callable[[Callable[..., Any]], CustomOpDef]:
    """Define a function as the torch operator ``name``, which changes none of its arguments.

    Args:
        name: name of the operator, with its namespace.
        outputs: creates tensors with the shapes, dtypes and devices of the outputs, without their values, for
            ``torch.compile`` and fake tensors. Its parameters are those of the operator's arguments that it needs.
        devices: types of the devices on which the operator works.
    """
    needed = signature(outputs).parameters

    def define(function: Callable[..., Any]) -> CustomOpDef:
        def fake(*args: Any, **kwargs: Any) -> Any:
            given = parameters.bind(*args, **kwargs).arguments
            return outputs(**{key: given[key] for key in needed})

        parameters = signature(function)
        defined = torch.library.custom_op(name, function, mutates_args=(), device_types=devices)
        defined.register_fake(fake)
        return defined

    return define
