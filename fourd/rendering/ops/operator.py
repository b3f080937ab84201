"""Definition of torch operators."""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd import Function
from torch.autograd.profiler import record_function
from torch.library import CustomOpDef
from torch.utils.dlpack import to_dlpack

_TENSOR, _OTHER = -1, -2
_PLAIN = {Tensor, nn.Parameter}


def uninitialised(like: Tensor, *shape: int) -> Tensor:
    """Return a tensor with the dtype and the device of another, whose values are not set. In contrast to
    ``Tensor.new_empty`` and ``torch.empty_like``, this calls a single operator."""
    return torch.empty(shape, dtype=like.dtype, device=like.device)


def kernel_array(tensor: Tensor) -> Any:
    """Return a CPU tensor as an argument of a kernel, which takes a tenth of the time that :func:`as_array` takes. Only
    one call can use the result. The tensor is copied only if it is not contiguous."""
    return to_dlpack(tensor if tensor.is_contiguous() else tensor.detach().contiguous())


class Operator:
    """A torch operator that changes none of its arguments, with or without a gradient.

    It is a ``torch.library.custom_op``, which ``torch.compile``, fake tensors and ``torch.func`` use. For plain tensors
    outside of them, the function and its gradient are called without torch's dispatcher: the dispatcher takes 0.1 ms
    for a call, and a training step has 17 calls, in which only one thread works.
    """

    def __init__(self, name: str, function: Callable[..., Any], defined: CustomOpDef, devices: tuple[str, ...]) -> None:
        self._name = name
        self._function = function
        self.defined = defined
        self._devices = devices
        self._gradient: type[Function] | None = None

    def register_autograd(self, backward: Callable[..., Any], *, setup_context: Callable[..., Any]) -> None:
        """Define the gradient, with the functions that ``CustomOpDef.register_autograd`` takes."""
        self.defined.register_autograd(backward, setup_context=setup_context)
        self._gradient = _gradient(self._name, self._function, backward, setup_context)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        tensors = _tensors(args)
        if kwargs or not self._is_direct(tensors):
            return self.defined(*args, **kwargs)
        if not (torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)):
            return self._recorded(self._function, args)
        if self._gradient is None:
            return self.defined(*args)  # An error if its result is differentiated.
        return self._recorded(self._gradient.apply, (args, *tensors))

    def _is_direct(self, tensors: list[Tensor]) -> bool:
        """Return true if nothing but autograd needs to know of a call with these tensors."""
        if torch.compiler.is_compiling() or torch._C._len_torch_dispatch_stack() > 0:
            return False
        if torch._C._functorch.peek_interpreter_stack() is not None or not tensors:
            return False
        return tensors[0].device.type in self._devices and all(type(tensor) in _PLAIN for tensor in tensors)

    def _recorded(self, function: Callable[..., Any], args: tuple[Any, ...]) -> Any:
        """Call a function. torch's profiler, if it is active, shows the call under the operator's name."""
        if not torch.autograd._profiler_enabled():
            return function(*args)
        with record_function(self._name):
            return function(*args)


def operator(
    name: str, *, outputs: Callable[..., Any], devices: tuple[str, ...] = ("cpu", "cuda")
) -> Callable[[Callable[..., Any]], Operator]:
    """Define a function as the torch operator ``name``, which changes none of its arguments.

    Args:
        name: name of the operator, with its namespace.
        outputs: creates tensors with the shapes, dtypes and devices of the outputs, without their values, for
            ``torch.compile`` and fake tensors. Its parameters are those of the operator's arguments that it needs.
        devices: types of the devices on which the operator works.
    """
    needed = signature(outputs).parameters

    def define(function: Callable[..., Any]) -> Operator:
        def fake(*args: Any, **kwargs: Any) -> Any:
            given = parameters.bind(*args, **kwargs).arguments
            return outputs(**{key: given[key] for key in needed})

        parameters = signature(function)
        defined = torch.library.custom_op(name, function, mutates_args=(), device_types=devices)
        defined.register_fake(fake)
        return Operator(name, function, defined, devices)

    return define


def _gradient(
    name: str, function: Callable[..., Any], backward: Callable[..., Any], setup_context: Callable[..., Any]
) -> type[Function]:
    """Return an autograd function whose ``apply`` takes the operator's arguments, and then the tensors among them."""

    def apply_forward(ctx: Any, args: tuple[Any, ...], *_: Tensor) -> Any:
        out = function(*args)
        setup_context(ctx=ctx, inputs=args, output=out)
        ctx.layout = tuple(_tensor_count(each) for each in args)
        return out

    def apply_backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        flat = ctx.needs_input_grad
        ctx.needs_input_grad = _nested(ctx.layout, flat[1:])
        try:
            found = backward(ctx, *gradients)
        finally:
            ctx.needs_input_grad = flat
        out: list[Tensor | None] = [None]
        for count, each in zip(ctx.layout, found if isinstance(found, tuple) else (found,), strict=True):
            if count == _TENSOR:
                out.append(each)
            elif count != _OTHER:
                out.extend([None] * count if each is None else each)
        return tuple(out)

    members = {"forward": staticmethod(apply_forward), "backward": staticmethod(apply_backward)}
    return type(name.replace("::", "_"), (Function,), members)


def _tensor_count(argument: Any) -> int:
    """Return the number of tensors in a list of tensors, _TENSOR for a tensor, and _OTHER for other arguments."""
    if isinstance(argument, Tensor):
        return _TENSOR
    return len(argument) if isinstance(argument, list) and argument and isinstance(argument[0], Tensor) else _OTHER


def _tensors(args: tuple[Any, ...]) -> list[Tensor]:
    """Return all tensors in the arguments of an operator."""
    out: list[Tensor] = []
    for each in args:
        if isinstance(each, Tensor):
            out.append(each)
        elif isinstance(each, list) and each and isinstance(each[0], Tensor):
            out.extend(each)
    return out


def _nested(layout: tuple[int, ...], flags: tuple[bool, ...]) -> tuple[bool | list[bool], ...]:
    """Return the flags of all tensors as a flag or a list of flags for each argument."""
    left = iter(flags)
    return tuple(
        next(left) if count == _TENSOR else False if count == _OTHER else [next(left) for _ in range(count)]
        for count in layout
    )
