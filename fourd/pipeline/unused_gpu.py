"""A notice, shown once, that this machine has an NVIDIA GPU which fourd cannot use."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import platformdirs
import torch

from fourd.rendering.ops.gpu import cuda_unavailable_reason

NO_KERNELS = (
    "this machine has an NVIDIA GPU, but this installation has only CPU kernels, as wheels do; to train on the GPU, "
    "install CUDA's compiler nvcc and a CUDA build of torch, then run: pip install --no-binary fourd 'fourd[train]' "
    "(in a checkout: pip install '.[train]')"
)
NO_CUDA_TORCH = (
    "this machine has an NVIDIA GPU, but torch {version} cannot use it; to train on the GPU, install a CUDA build of "
    "torch (https://pytorch.org/get-started)"
)


def unused_gpu_notice() -> str:
    """Return why the GPU of this machine is not used and how to change that, or '' if there is no NVIDIA GPU or nothing
    is missing."""
    if not (torch.cuda.is_available() or Path("/dev/nvidia0").exists() or shutil.which("nvidia-smi")):
        return ""
    if cuda_unavailable_reason():
        return NO_KERNELS
    return "" if torch.cuda.is_available() else NO_CUDA_TORCH.format(version=torch.__version__)


def tell_once(log: Callable[[str], None], folder: Path | None = None) -> None:
    """Log the notice, if there is one and no earlier call on this machine has logged it.

    ``folder`` is the folder that remembers the call, by default the platform's folder for application state. If the
    folder cannot be written, the next call logs the notice again.
    """
    notice = unused_gpu_notice()
    told = (platformdirs.user_state_path("fourd") if folder is None else folder) / "unused_gpu_notice"
    if not notice or told.exists():
        return
    log(f"device: {notice}")
    with suppress(OSError):
        told.parent.mkdir(parents=True, exist_ok=True)
        told.touch()
