"""Description of the machine on which a benchmark runs."""

from __future__ import annotations

import platform
import subprocess
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import torch

from fourd.rendering.ops.gpu import has_gpu
from fourd.rendering.ops.loading import load_native, simd_name, thread_count


@dataclass(frozen=True)
class Machine:
    """The machine, the kernels' settings and the software versions."""

    processor: str
    gpu: str | None
    """Name of the CUDA device; None without a device or without CUDA kernels."""
    threads: int
    simd: str
    system: str
    python: str
    torch: str
    fourd: str
    commit: str | None
    """Git commit of the source folder, or None outside a repository. A "+" marks uncommitted changes."""

    def __str__(self) -> str:
        built = self.fourd if self.commit is None else f"{self.fourd} ({self.commit})"
        gpu = "" if self.gpu is None else f", {self.gpu}"
        return f"{self.processor}{gpu}, {self.threads} threads, {self.simd}; torch {self.torch}, fourd {built}"


def this_machine() -> Machine:
    """Describe the machine that this program runs on."""
    return Machine(
        processor=_processor(),
        gpu=torch.cuda.get_device_name() if has_gpu() else None,
        threads=thread_count(0, torch.get_num_threads()),
        simd=simd_name() or load_native().simd_default(),
        system=f"{platform.system()} {platform.machine()}",
        python=platform.python_version(),
        torch=torch.__version__,
        fourd=version("fourd"),
        commit=_commit(),
    )


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _commit() -> str | None:
    folder = Path(__file__).resolve().parents[2]
    if not (folder / ".git").exists():
        return None
    try:
        described = subprocess.run(
            ["git", "-C", str(folder), "describe", "--always", "--dirty=+", "--exclude=*"],
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip()
