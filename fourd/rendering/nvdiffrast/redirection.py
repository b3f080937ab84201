"""Runs scripts that use a CUDA device on the CPU: :func:`run_on_cpu`.

A mode of torch (TorchFunctionMode) replaces the device argument of every torch function. Functions that torch does not
pass to modes, such as ``torch.cuda.synchronize``, are replaced by those of :mod:`fourd.rendering.nvdiffrast.stand_ins`.
"""

from __future__ import annotations

import re
import sys
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode, resolve_name

from fourd.rendering.nvdiffrast.stand_ins import stand_ins

_CUDA = re.compile(r"cuda(:\d+)?")
_LIBRARIES = ("torch", "fourd", "contextlib", "runpy", "importlib")


class CpuRun:
    """The redirection that :func:`run_on_cpu` has started.

    It ends with :meth:`close` or at the end of a ``with`` block, or else with the process.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stack = ExitStack()
        report = _Report(stream)
        for owner, name, value in stand_ins(report.once):
            self._stack.callback(setattr, owner, name, getattr(owner, name))
            setattr(owner, name, value)
        self._stack.enter_context(_CpuMode(report))

    def __enter__(self) -> CpuRun:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the redirection. Redirections must end in the reverse of the order in which they started."""
        self._stack.close()


def run_on_cpu(stream: TextIO | None = None) -> CpuRun:
    """Redirect calls that use a CUDA device to the CPU, from now until the process ends.

    ``tensor.cuda()``, ``module.cuda()``, ``.to("cuda")`` and the argument ``device="cuda"`` give tensors on the CPU,
    and the functions of ``torch.cuda`` that scripts use most (``is_available``, ``synchronize``, ``Event`` and others)
    work without a device. Each kind of replaced call is reported once, with the line of its first use. As with a GPU,
    ``.cuda()``, ``.cpu()`` and ``.to()`` return copies of tensors. Only ``.cuda()`` and ``.to("cuda")`` of leaf tensors
    that require a gradient return the tensor itself.

    The redirection changes functions of torch, so call it only in a script, not in a library. It has effect in the
    thread that calls it. To end it, use it as a context manager::

        with run_on_cpu():
            ...

    ``tensor.is_cuda`` and ``tensor.device`` are not changed: they tell that the tensor is on the CPU.

    Args:
        stream: where replaced calls are reported; by default the standard error output.
    """
    return CpuRun(sys.stderr if stream is None else stream)


class _Report:
    """Prints one line for each kind of replaced call."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._seen: set[str] = set()

    def once(self, call: str, instead: str) -> None:
        if call in self._seen:
            return
        if not self._seen:
            print("run_on_cpu: CUDA calls run on the CPU; the first of each kind:", file=self._stream)
        self._seen.add(call)
        print(f"run_on_cpu: {_calling_line()}: {call}: {instead}", file=self._stream, flush=True)


def _calling_line() -> str:
    """Return file and line of the innermost call in a script, not in a library."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] in _LIBRARIES:
        frame = frame.f_back
    return f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"


class _CpuMode(TorchFunctionMode):
    """Replaces CUDA devices in the arguments of torch functions by the CPU."""

    def __init__(self, report: _Report) -> None:
        super().__init__()
        self._report = report

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func is Tensor.cuda:
            self._report.once("Tensor.cuda()", "stays on the CPU")
            return _transferred(args[0], args[0])
        if func is Tensor.cpu:
            return _transferred(args[0], func(*args, **kwargs), keeps_leaves=False)
        if func is Tensor.pin_memory:
            self._report.once("Tensor.pin_memory()", "not pinned")
            return args[0]
        args, is_changed = self._on_cpu(func, args, kwargs)
        result = func(*args, **kwargs)
        if func in (Tensor.to, torch.as_tensor, torch.asarray) and (is_changed or _names_cpu(args, kwargs)):
            source = args[0] if args else kwargs.get("data", kwargs.get("obj"))
            return _transferred(source, result, keeps_leaves=is_changed)
        return result

    def _on_cpu(self, func: Any, args: Any, kwargs: dict[str, Any]) -> tuple[Any, bool]:
        """Replace the devices in ``args`` and ``kwargs``. Return ``args``, and whether something was replaced."""
        if func in (torch.device, torch._C._nn._parse_to):
            # These only name a device; the calls that use it are replaced. Without CUDA, a device number is an error.
            return tuple(f"cuda:{arg}" if isinstance(arg, int) and k == 0 else arg for k, arg in enumerate(args)), False
        changed = [argument for argument in args if _is_cuda(argument)]
        args = tuple("cpu" if _is_cuda(argument) else argument for argument in args)
        if func is Tensor.to and len(args) > 1 and isinstance(args[1], int):
            changed.append(args[1])
            args = (args[0], "cpu", *args[2:])
        device = kwargs.get("device")
        if _is_cuda(device) or isinstance(device, int):
            changed.append(device)
            kwargs["device"] = "cpu"
        if kwargs.get("pin_memory"):
            kwargs["pin_memory"] = False
        if changed:
            name = (resolve_name(func) or getattr(func, "__name__", "a function")).removeprefix("torch.")
            name = name if name.startswith("Tensor.") else f"torch.{name}"
            self._report.once(f'{name}(device="{changed[0]}")', "on the CPU")
        if func is Tensor.type and any(str(argument).find("torch.cuda.") >= 0 for argument in args[1:]):
            self._report.once("Tensor.type(torch.cuda...)", "stays on the CPU")
            args = (args[0], *(_cpu_type(argument) for argument in args[1:]))
        return args, bool(changed)


def _is_cuda(value: object) -> bool:
    if isinstance(value, torch.device):
        return value.type == "cuda"
    return isinstance(value, str) and _CUDA.fullmatch(value) is not None


def _cpu_type(value: Any) -> Any:
    return value.replace("torch.cuda.", "torch.") if isinstance(value, str) else value


def _names_cpu(args: tuple[Any, ...], kwargs: dict[str, Any]) -> bool:
    values = [*args[1:], kwargs.get("device")]
    return any(value == "cpu" or (isinstance(value, torch.device) and value.type == "cpu") for value in values)


def _transferred(source: Any, result: Tensor, keeps_leaves: bool = True) -> Tensor:
    """Return a copy of ``result`` if it shares its memory with ``source``.

    A transfer between devices copies. Without a copy, a script that later changes one of the two would silently change
    the other. If ``keeps_leaves`` is true, leaf tensors that require a gradient are returned themselves, because an
    optimizer may hold them: on a GPU, ``parameter.cuda()`` returns a parameter that is already there.
    """
    if isinstance(source, Tensor):
        if keeps_leaves and source.requires_grad and source.is_leaf:
            return result
        is_shared = result.layout != torch.strided or (
            result.untyped_storage().data_ptr() == source.untyped_storage().data_ptr()
        )
    else:
        is_shared = not result.untyped_storage().resizable()  # It is the memory of a NumPy array.
    return result.clone() if is_shared else result
