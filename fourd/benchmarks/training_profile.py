"""A profile of training steps: the time of each operator forward and backward, the time between operators, and the part
of a step that uses only one thread."""

from __future__ import annotations

import os
import statistics
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from rich.table import Table
from torch.profiler import ProfilerActivity, profile, record_function

from fourd.base.parallel import core_count
from fourd.base.progress import Terminal
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.memory import retain_freed_memory
from fourd.reconstruction.training.run import Run

STEP = "fourd training step"
BACKWARD = "autograd::engine::evaluate_function: "
RATE_FACTOR = 1e-6
"""Factor of all learning rates. Profiled steps must not change the scene, so that all of them do the same work."""
SHOWN_ROWS = 25


@dataclass(frozen=True)
class OperatorTime:
    """Mean time in milliseconds that a step spends in one operator, with the operators that it calls.

    Attributes:
        name: name of the operator.
        forward_ms: time outside the backward pass.
        backward_ms: time in the backward pass.
        events: number of operator events.
    """

    name: str
    forward_ms: float
    backward_ms: float
    events: float


@dataclass(frozen=True)
class GpuWork:
    """Work of a GPU in one step: time in kernels in milliseconds, numbers of kernel launches and of waits of the CPU
    for the GPU."""

    kernel_ms: float
    launches: float
    synchronisations: float


@dataclass(frozen=True)
class TrainingProfile:
    """Means over the profiled steps.

    Attributes:
        operators: the outermost operators, with the slowest first.
        between_ms: time outside all operators: Python, and torch between operators.
        events: number of operator events.
        step_ms: number of threads -> median time of a step in milliseconds, without the profiler.
        gpu: work of the GPU, or None if the scene is trained on the CPU.
    """

    operators: tuple[OperatorTime, ...]
    between_ms: float
    events: float
    step_ms: dict[int, float]
    gpu: GpuWork | None

    def serial_share(self, threads: int) -> float:
        """Estimate the fraction of a one-thread step that does not use several threads, by Amdahl's law."""
        return serial_share(self.step_ms[1], self.step_ms[threads], threads)


def serial_share(alone_ms: float, together_ms: float, threads: int) -> float:
    """Solve ``together = alone * (s + (1 - s) / threads)`` for the serial share s, for at least two threads."""
    return (threads * together_ms / alone_ms - 1) / (threads - 1)


def profile_training(run: Run, config: TrainConfig, device: torch.device, steps: int = 20) -> TrainingProfile:
    """Profile ``steps`` successive steps of a run, which are repeated with 1, 2 and all threads. No checkpoint is
    written."""
    retain_freed_memory()
    trainer = Trainer(run, None, Terminal(quiet=True), config, device=device)
    for number in range(2 * config.encoder_every):  # The first steps also decode images and allocate memory.
        _step(trainer, number)
    times = _thread_times(trainer, steps)
    on_gpu = device.type == "cuda"
    activities = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if on_gpu else [])]
    with profile(activities=activities) as found:
        for number in range(steps):
            with record_function(STEP):
                _step(trainer, number)
    events = list(found.events())
    operators, between_ms = _operator_times(events, steps)
    inside = [event for event in events if event.name != STEP and event.device_type == torch.autograd.DeviceType.CPU]
    return TrainingProfile(
        operators, between_ms, len(inside) / steps, times, _gpu_work(events, steps) if on_gpu else None
    )


def tables(found: TrainingProfile) -> Iterator[Table]:
    """Format a profile as tables for the terminal."""
    alone = found.step_ms[1]
    speed = Table(box=None, pad_edge=False)
    for title in ("threads", "ms a step", "times as fast", "serial share"):
        speed.add_column(title, justify="right")
    for threads, ms in found.step_ms.items():
        share = f"{found.serial_share(threads):.0%}" if threads > 1 else ""
        speed.add_row(str(threads), f"{ms:.1f}", f"{alone / ms:.2f}", share)
    yield speed
    work = Table(box=None, pad_edge=False)
    work.add_column("operator, with the profiler", max_width=70)
    for title in ("forward ms", "backward ms", "events"):
        work.add_column(title, justify="right")
    shown, rest = found.operators[:SHOWN_ROWS], found.operators[SHOWN_ROWS:]
    if rest:
        name = f"{len(rest)} other operators"
        shown = (*shown, OperatorTime(name, *(sum(each) for each in zip(*map(_numbers, rest), strict=True))))
    for row in shown:
        work.add_row(row.name, *(f"{number:.1f}" for number in _numbers(row)))
    work.add_row("Python and torch between operators", f"{found.between_ms:.1f}", "", "")
    work.add_row("all operator events", "", "", f"{found.events:.0f}")
    yield work
    if found.gpu is not None:
        gpu = Table("GPU: kernels ms", "launches", "synchronisations", box=None, pad_edge=False)
        gpu.add_row(f"{found.gpu.kernel_ms:.1f}", f"{found.gpu.launches:.0f}", f"{found.gpu.synchronisations:.0f}")
        yield gpu


def _numbers(row: OperatorTime) -> tuple[float, float, float]:
    return row.forward_ms, row.backward_ms, row.events


def _step(trainer: Trainer, number: int) -> None:
    trainer.run_step(number, RATE_FACTOR)
    if trainer.scene.views.device.type == "cuda":
        torch.cuda.synchronize()


def _thread_times(trainer: Trainer, steps: int) -> dict[int, float]:
    """Measure the median time of a step for each number of threads. The numbers alternate from step to step, because
    other programs may use the machine."""
    available = core_count()
    times: dict[int, list[float]] = {threads: [] for threads in sorted({1, min(2, available), available})}
    for number in range(steps):
        for threads, found in times.items():
            with _threads(threads):
                started = time.perf_counter()
                _step(trainer, number)
                found.append(1e3 * (time.perf_counter() - started))
    return {threads: statistics.median(found) for threads, found in times.items()}


@contextmanager
def _threads(number: int) -> Iterator[None]:
    """Set the number of threads of torch and of the kernels."""
    before, kernels = torch.get_num_threads(), os.environ.get("FOURD_THREADS")
    torch.set_num_threads(number)
    os.environ["FOURD_THREADS"] = str(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        if kernels is None:
            del os.environ["FOURD_THREADS"]
        else:
            os.environ["FOURD_THREADS"] = kernels


def _operator_times(events: Iterable[Any], steps: int) -> tuple[tuple[OperatorTime, ...], float]:
    """Sum the times of the outermost operators by name. Returns them with the time between them."""
    totals: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
    between = 0.0
    for event in events:
        if event.name != STEP or event.device_type != torch.autograd.DeviceType.CPU:
            continue
        between += event.self_cpu_time_total
        for child in event.cpu_children:
            is_backward = child.name.startswith(BACKWARD)
            total = totals[_short_name(child.name)]
            total[is_backward] += child.cpu_time_total
            total[2] += _event_count(child)
    rows = [OperatorTime(name, a / steps / 1e3, b / steps / 1e3, n / steps) for name, (a, b, n) in totals.items()]
    return tuple(sorted(rows, key=lambda row: -row.forward_ms - row.backward_ms)), between / steps / 1e3


def _short_name(name: str) -> str:
    """Return one name for an operator of fourd and its gradient."""
    name = name.removeprefix(BACKWARD)
    return f"fourd::{name[6:].removesuffix('Backward')}" if name.startswith("fourd_") else name


def _event_count(event: Any) -> int:
    return 1 + sum(_event_count(child) for child in event.cpu_children)


def _gpu_work(events: Sequence[Any], steps: int) -> GpuWork:
    kernels = [event for event in events if event.device_type == torch.autograd.DeviceType.CUDA]
    names = [event.name for event in events if event.device_type == torch.autograd.DeviceType.CPU]
    counts = [sum(word in name for name in names) / steps for word in ("LaunchKernel", "Synchronize")]
    return GpuWork(sum(event.device_time_total for event in kernels) / steps / 1e3, *counts)
