"""Describe the installation and the machine, for reports of problems."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from fourd.base.errors import UserError, one_line
from fourd.rendering.ops.loading import load_native, simd_name, thread_count

PACKAGES = ("numpy", "opencv-contrib-python-headless", "av", "moderngl", "torch", "pycolmap", "glfw", "imgui-bundle")
"""Names of the packages, as on PyPI, whose versions are shown."""
CPU_FLAGS = ("f16c", "fma", "avx2", "avx512f", "avx512dq", "avx512vl")
"""Flags of /proc/cpuinfo that the kernels can use."""
_MAX_REASON = 160


def describe_system() -> list[tuple[str, str]]:
    """Return names and values: versions, the processor, the kernels, and the GPU for training and for OpenGL.

    No value contains a path of a user's file or another name that the user has chosen.
    """
    from fourd.base.version import __version__

    return [
        ("fourd", __version__),
        ("Python", f"{platform.python_version()}, {platform.python_implementation()}"),
        ("system", platform.platform()),
        *((name, _version(name)) for name in PACKAGES),
        ("processor", f"{_processor()}; {os.cpu_count()} cores, of which kernels use {thread_count(0)}"),
        ("CPU kernels", _cpu_kernels()),
        ("CUDA", _cuda()),
        ("OpenGL", _opengl()),
    ]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    """Return the name of the processor, with the flags that the kernels can use if the system lists them."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor() or platform.machine()
    values = dict(line.replace("\t", "").split(":", 1) for line in text.split("\n\n")[0].splitlines() if ":" in line)
    flags = set(values.get("flags", "").split())
    known = " ".join(flag for flag in CPU_FLAGS if flag in flags)
    name = values.get("model name", "").strip() or platform.machine()
    return f"{name} ({known or 'no known flags'})"


def _cpu_kernels() -> str:
    try:
        widest = load_native().simd_default()
    except ImportError as error:
        return f"not available: {one_line(error, _MAX_REASON)}"
    chosen = simd_name()
    return f"built; instruction set {chosen} (FOURD_SIMD)" if chosen else f"built; instruction set {widest}"


def _cuda() -> str:
    """Describe the GPU that training uses, or name the reason why it uses none."""
    if find_spec("torch") is None:
        return "not available: torch is not installed"
    import torch

    from fourd.rendering.ops.gpu import cuda_unavailable_reason

    missing = one_line(ImportError(cuda_unavailable_reason()), _MAX_REASON)
    kernels = f"kernels not available: {missing}" if missing else "kernels built"
    build = f"torch for CUDA {torch.version.cuda}" if torch.version.cuda else "torch without CUDA"
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else "no GPU that torch can use"
    return f"{gpu}; {build}; {kernels}"


def _opengl() -> str:
    """Describe the driver of OpenGL, or name the reason why there is none."""
    from fourd.viewer.gl.context import driver_info, offscreen_context

    try:
        context = offscreen_context()
    except UserError as error:
        return f"not available: {one_line(error, _MAX_REASON)}"
    info = driver_info(context)
    context.release()
    return f"{info['GL_RENDERER']}; version {info['GL_VERSION']}"
