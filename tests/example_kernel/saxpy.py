"""The operator of the example kernel, and its reference. In the package, the path of this file would be
``fourd/rendering/ops/saxpy.py``."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.loading import as_array, simd_name


def saxpy(a: float, x: Tensor, y: Tensor) -> Tensor:
    """Return ``a * x + y`` for two float32 CPU tensors (N,). The result is differentiable with respect to both tensors.

    Raises:
        ValueError: if a tensor has another shape, device or dtype.
    """
    for name, values in (("x", x), ("y", y)):
        if values.dim() != 1 or values.dtype != torch.float32 or values.device.type != "cpu":
            raise ValueError(
                f"{name}: expected float32 values (N,) on the CPU, got {values.dtype} {tuple(values.shape)}"
            )
    return _saxpy(a, x, y)


def saxpy_reference(a: float, x: Tensor, y: Tensor) -> Tensor:
    """Compute ``a * x + y`` in plain torch, on any device and in any dtype."""
    return a * x + y


@torch.library.custom_op("fourd_example::saxpy", mutates_args=(), device_types="cpu")
def _saxpy(a: float, x: Tensor, y: Tensor) -> Tensor:
    import _example  # in the package: load_native()

    out = torch.empty_like(x, memory_format=torch.contiguous_format)
    _example.saxpy(a, as_array(x), as_array(y), simd_name(), out.numpy())
    return out


@_saxpy.register_fake
def _(a: float, x: Tensor, y: Tensor) -> Tensor:
    return torch.empty_like(x, memory_format=torch.contiguous_format)


def _setup(ctx: Any, inputs: tuple[float, Tensor, Tensor], output: Tensor) -> None:
    ctx.a = inputs[0]


def _backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor, Tensor]:
    return None, ctx.a * gradient, gradient.clone()


_saxpy.register_autograd(_backward, setup_context=_setup)
