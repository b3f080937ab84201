"""The CUDA kernels of ``csrc`` for torch tensors: what gives them memory and stream.

Nothing here waits for the GPU. On a CPU tensor the same functions run the kernels' source emulated, thread by
thread: slow, and how they are tested where there is no GPU. FOURD_SIMD=emulated makes the operators take that way.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from fourd.ops.loading import native, simd_name


@dataclass(frozen=True)
class Gpu:
    """A device's kernels.

    Attributes:
        kernels: ``fourd._cuda``, or what emulates it.
        rooms: how much room pictures needed on this device lately.
        device: the device.
    """

    kernels: ModuleType
    rooms: Any
    device: torch.device

    @property
    def stream(self) -> int:
        """The handle of torch's current stream."""
        return torch.cuda.current_stream(self.device).cuda_stream if self.device.type == "cuda" else 0

    def current(self) -> AbstractContextManager[Any]:
        """Makes the device the one that kernels are started on."""
        return torch.cuda.device(self.device) if self.device.type == "cuda" else nullcontext()

    def memory(self, size: int) -> Tensor:
        """So many bytes, of torch's own: whatever comes after on the stream may use them again."""
        return torch.empty(size, dtype=torch.uint8, device=self.device)


@cache
def load_gpu(device: torch.device) -> Gpu:
    """The kernels for a device; the CPU's are emulated.

    Raises:
        ImportError: where they are not built.
    """
    if device.type == "cuda":
        kernels = import_module("fourd._cuda")
    elif hasattr(native(), "emulated"):
        kernels = native().emulated
    else:
        raise ImportError("fourd._native.emulated: expected the emulated kernels, which this build is without")
    return Gpu(kernels, kernels.Rooms(), device)


@cache
def cuda_unavailable_reason() -> str:
    """Why there are no CUDA kernels; empty where there are."""
    try:
        import_module("fourd._cuda")
    except ImportError as cause:
        return str(cause)
    return ""


def takes(tensor: Tensor) -> bool:
    """Whether the kernels here are those for a tensor: on a CUDA device, or where FOURD_SIMD wants them emulated."""
    return tensor.device.type == "cuda" or simd_name() == "emulated"


def dense(tensor: Tensor) -> Tensor:
    """The tensor as kernels take it; a copy only where it is not contiguous."""
    return tensor.detach().contiguous()
