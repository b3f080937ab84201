"""What :func:`fourd.rendering.nvdiffrast.run_on_cpu` puts in place of functions of torch that need a CUDA device."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import torch

Report = Callable[[str, str], None]
"""Takes the name of a replaced function and what it does instead."""

_WITHOUT_EFFECT = (
    "synchronize",
    "empty_cache",
    "ipc_collect",
    "set_device",
    "init",
    "reset_peak_memory_stats",
    "reset_max_memory_allocated",
    "reset_max_memory_cached",
    "set_per_process_memory_fraction",
)
_ZERO = ("memory_allocated", "max_memory_allocated", "memory_reserved", "max_memory_reserved", "utilization")
_TENSORS = ("Float", "Double", "Half", "BFloat16", "Int", "Long", "Short", "Char", "Byte", "Bool")
_NAME = "CPU"


def stand_ins(report: Report) -> list[tuple[Any, str, Any]]:
    """Return the attributes to set, as (owner, name, value)."""
    cuda = torch.cuda
    out: list[tuple[Any, str, Any]] = [(cuda, name, _function(report, name, None)) for name in _WITHOUT_EFFECT]
    out += [(cuda, name, _function(report, name, 0)) for name in _ZERO]
    out += [(cuda, f"{kind}Tensor", getattr(torch, f"{kind}Tensor")) for kind in _TENSORS]
    out += [
        (cuda, "is_available", _Answer(report, "is_available", True, cuda.is_available)),
        (cuda, "is_initialized", _Answer(report, "is_initialized", True, cuda.is_initialized)),
        (cuda, "device_count", _Answer(report, "device_count", 1, cuda.device_count)),
        (cuda, "current_device", _Answer(report, "current_device", 0, cuda.current_device)),
        (cuda, "get_device_name", _function(report, "get_device_name", _NAME)),
        (cuda, "get_device_capability", _function(report, "get_device_capability", (0, 0))),
        (cuda, "get_device_properties", _function(report, "get_device_properties", _properties())),
        (cuda, "device", _function(report, "device", nullcontext())),
        (cuda, "stream", _function(report, "stream", nullcontext())),
        (cuda, "Event", _factory(report, "Event", CpuEvent)),
        (cuda, "Stream", _factory(report, "Stream", CpuStream)),
        (cuda, "current_stream", _factory(report, "current_stream", CpuStream)),
        (cuda, "default_stream", _factory(report, "default_stream", CpuStream)),
    ]
    out += [(cuda.nvtx, name, _function(report, f"nvtx.{name}", None)) for name in ("range_push", "range_pop", "mark")]
    return [*out, *_of_torch(report)]


def _of_torch(report: Report) -> list[tuple[Any, str, Any]]:
    generator, load = torch.Generator, torch.load
    set_device, set_type = torch.set_default_device, torch.set_default_tensor_type

    class Generator(metaclass=_CpuGenerators):
        real, report_once = generator, staticmethod(report)

    def load_on_cpu(f: Any, map_location: Any = None, *args: Any, **kwargs: Any) -> Any:
        if map_location is None or _names_cuda(map_location):
            report("torch.load()", "onto the CPU")
            map_location = "cpu"
        return load(f, map_location, *args, **kwargs)

    def set_default_device(device: Any) -> None:
        if _names_cuda(device):
            report(f'torch.set_default_device("{device}")', "the CPU")
            device = "cpu"
        set_device(device)

    def set_default_tensor_type(kind: Any) -> None:
        if isinstance(kind, str) and kind.startswith("torch.cuda."):
            report(f"torch.set_default_tensor_type({kind})", "the type on the CPU")
            kind = kind.replace("torch.cuda.", "torch.")
        set_type(kind)

    return [
        (torch, "Generator", Generator),
        (torch, "load", load_on_cpu),
        (torch, "set_default_device", set_default_device),
        (torch, "set_default_tensor_type", set_default_tensor_type),
    ]


class CpuEvent:
    """A ``torch.cuda.Event`` that records the time of the CPU."""

    def __init__(self, enable_timing: bool = False, blocking: bool = False, interprocess: bool = False) -> None:
        self._time_s = 0.0

    def record(self, stream: object = None) -> None:
        """Record the time."""
        self._time_s = time.perf_counter()

    def elapsed_time(self, end_event: CpuEvent) -> float:
        """Return the time until ``end_event`` in milliseconds."""
        return 1000 * (end_event._time_s - self._time_s)

    def query(self) -> bool:
        """Return true: the CPU has finished."""
        return True

    def synchronize(self) -> None:
        """Does nothing."""

    def wait(self, stream: object = None) -> None:
        """Does nothing."""


class CpuStream:
    """A ``torch.cuda.Stream`` whose work is always finished."""

    cuda_stream = 0

    def __init__(self, device: object = None, priority: int = 0) -> None:
        pass

    def __enter__(self) -> CpuStream:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def query(self) -> bool:
        """Return true: the CPU has finished."""
        return True

    def record_event(self, event: CpuEvent | None = None) -> CpuEvent:
        """Record the time in an event and return it."""
        event = CpuEvent() if event is None else event
        event.record()
        return event

    def synchronize(self) -> None:
        """Does nothing."""

    def wait_event(self, event: object) -> None:
        """Does nothing."""

    def wait_stream(self, stream: object) -> None:
        """Does nothing."""


class _Answer:
    """Answers a question about CUDA devices: a script gets the answer of a machine with one device, and torch itself,
    which would use the device, gets the truth."""

    def __init__(self, report: Report, name: str, value: object, truth: Callable[[], Any]) -> None:
        self._report, self._name, self._value, self._truth = report, name, value, truth

    def __call__(self) -> Any:
        if sys._getframe(1).f_globals.get("__name__", "").split(".")[0] == "torch":
            return self._truth()
        self._report(f"torch.cuda.{self._name}()", str(self._value))
        return self._value


class _CpuGenerators(type):
    """Makes ``torch.Generator("cuda")`` return a generator for the CPU."""

    def __call__(cls: Any, device: Any = "cpu") -> torch.Generator:
        if _names_cuda(device):
            cls.report_once(f'torch.Generator("{device}")', "for the CPU")
            device = "cpu"
        generator: torch.Generator = cls.real(device)
        return generator

    def __instancecheck__(cls: Any, value: object) -> bool:
        return isinstance(value, cls.real)


def _function(report: Report, name: str, value: Any) -> Callable[..., Any]:
    instead = "no effect" if value is None or isinstance(value, nullcontext) else f"{value}"

    def replaced(*args: object, **kwargs: object) -> Any:
        report(f"torch.cuda.{name}()", instead)
        return value

    return replaced


def _factory(report: Report, name: str, kind: type) -> Callable[..., Any]:
    def replaced(*args: Any, **kwargs: Any) -> Any:
        report(f"torch.cuda.{name}()", "works on the CPU")
        return kind(*args, **kwargs)

    return replaced


def _properties() -> SimpleNamespace:
    return SimpleNamespace(name=_NAME, total_memory=0, major=0, minor=0, multi_processor_count=1)


def _names_cuda(device: object) -> bool:
    if isinstance(device, torch.device):
        return device.type == "cuda"
    return isinstance(device, str) and device.split(":")[0] == "cuda"
