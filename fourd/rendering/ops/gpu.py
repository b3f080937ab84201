"""Access to the CUDA kernels for torch tensors: the native module, the stream and scratch memory.

No function of this module waits for the GPU. To test the kernels on machines without a GPU, set the environment
variable FOURD_SIMD to "emulated": the operators then run the CUDA sources for CPU tensors in a slow emulator, which
executes one CUDA thread after another.
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

from fourd.base.errors import UserError
from fourd.base.processes.torchrun import local_rank
from fourd.rendering.ops.device_name import DeviceName
from fourd.rendering.ops.loading import simd_name

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Gpu:
    """The kernels of one device.

    Attributes:
        kernels: native module, ``fourd._cuda`` for a GPU or ``fourd._emulated`` for the CPU.
        estimator: native object that predicts the number of (point, tile) pairs of the next image on this device.
        device: device that the kernels run on.
    """

    kernels: ModuleType
    estimator: Any
    device: torch.device

    @property
    def stream(self) -> int:
        """Handle of torch's current CUDA stream; 0 for the emulator."""
        return torch.cuda.current_stream(self.device).cuda_stream if self.device.type == "cuda" else 0

    def activate(self) -> AbstractContextManager[Any]:
        """Return a context manager that selects ``device`` for kernel launches."""
        return torch.cuda.device(self.device) if self.device.type == "cuda" else nullcontext()

    def allocate(self, size: int) -> Tensor:
        """Allocate ``size`` bytes with torch's allocator.

        After the tensor is deleted, later work on the same stream may reuse the memory.
        """
        return torch.empty(size, dtype=torch.uint8, device=self.device)


@cache
def load_gpu(device: torch.device) -> Gpu:
    """Load the kernels for a device. For the CPU, the emulated kernels are loaded.

    Raises:
        ImportError: if the kernels are not built.
    """
    if device.type == "cuda":
        kernels = import_module("fourd._cuda")
    else:
        kernels = import_module("fourd._emulated")
    return Gpu(kernels, kernels.EntryEstimator(), device)


@cache
def cuda_unavailable_reason() -> str:
    """Return the reason why the CUDA kernels cannot be loaded, or '' if they can."""
    try:
        import_module("fourd._cuda")
    except ImportError as cause:
        return str(cause)
    return ""


def has_gpu() -> bool:
    """Return True if CUDA kernels can run on this machine."""
    return torch.cuda.is_available() and not cuda_unavailable_reason()


def choose_device(name: DeviceName) -> torch.device:
    """Return the device with the given name. If torchrun has started several processes on this machine, they are
    distributed over its GPUs.

    Raises UserError for "cuda" if fourd cannot use a GPU.
    """
    if name == "cpu":
        return CPU
    if has_gpu():
        return torch.device("cuda", local_rank() % torch.cuda.device_count())
    if name == "cuda":
        got = (
            cuda_unavailable_reason() if torch.cuda.is_available() else f"no GPU that torch {torch.__version__} can use"
        )
        raise UserError(f"--device: expected an NVIDIA GPU for 'cuda', got {got}; use --device cpu")
    return CPU


def uses_gpu_kernels(tensor: Tensor) -> bool:
    """Return True if operators run CUDA kernels on this tensor: if it is on a CUDA device or the environment variable
    FOURD_SIMD is "emulated"."""
    return tensor.device.type == "cuda" or simd_name() == "emulated"


def contiguous(tensor: Tensor) -> Tensor:
    """Return the detached tensor in contiguous memory, copied only if it is not contiguous."""
    return tensor.detach().contiguous()
