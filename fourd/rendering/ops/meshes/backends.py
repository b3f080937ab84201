"""Selects the implementation of a triangle operator: a kernel, or the reference in plain torch."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import cuda_unavailable_reason

Backend = Literal["auto", "reference", "cpu", "cuda"]


def select_backend(backend: str, name: str, value: Tensor) -> Literal["reference", "native"]:
    """Return "reference" if ``backend`` selects the reference, or "native" if it selects the kernels for the tensors'
    device.

    Args:
        backend: "reference" for plain torch on any device (float32 or float64), "cpu" or "cuda" for the float32
            kernels, or "auto" for the kernels for the tensors' device.
        name, value: name and value of the argument whose device and dtype are checked. All tensors of the operator must
            have the same device and dtype.

    Raises:
        TypeError: if the kernels do not support the dtype of ``value``.
        ValueError: for an unknown backend, or a backend that does not run on the device of ``value``.
        RuntimeError: if the backend is not built.
    """
    if backend not in ("auto", "reference", "cpu", "cuda"):
        raise ValueError(f"backend: expected 'auto', 'reference', 'cpu' or 'cuda', got {backend!r}")
    if backend == "reference":
        return "reference"
    device = value.device.type
    required = ("cuda" if device == "cuda" else "cpu") if backend == "auto" else backend
    if required == "cuda" and (missing := cuda_unavailable_reason()):
        raise RuntimeError(
            "backend: expected an installed backend, got 'cuda', but fourd was built without CUDA "
            f"({missing}); install CUDA's compiler nvcc and then fourd again, move the tensors to the CPU, or use "
            "backend='reference', which runs on any device"
        )
    if device != required:
        raise ValueError(
            f"{name}: expected a tensor on {required!r} for backend {backend!r}, got one on {device!r}; "
            "backend='reference' runs on any device"
        )
    if value.dtype != torch.float32:
        raise TypeError(
            f"{name}: expected dtype float32 for backend {backend!r}, got {str(value.dtype).removeprefix('torch.')}; "
            "backend='reference' also takes float64"
        )
    return "native"
