"""Measure the run time of kernels and stages, and compare it with reference code and other installed packages."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.progress import Terminal
from fourd.cli.options import option
from fourd.cli.outputs import READS, WRITES_JSON, Writes
from fourd.rendering.ops.device_name import DeviceName

if TYPE_CHECKING:
    from fourd.benchmarks.report import Row


@dataclass(frozen=True)
class Arguments:
    """Times are printed in milliseconds and in units. One unit is the time that torch needs to multiply two 2048 x 2048
    float32 matrices. The unit is measured before every run of a timed function. When other programs use the machine,
    times in units vary less than times in milliseconds. CUDA kernels are timed if they are built and a CUDA device
    exists. The environment variables FOURD_THREADS and FOURD_SIMD set the number of threads and the instruction set of
    the CPU kernels."""

    json: Annotated[Path | None, WRITES_JSON, option("FILE", "none")] = None
    """Write all measurements to this file as JSON."""
    markdown: Annotated[Path | None, Writes(suffixes=(".md", ".markdown")), option("FILE", "none")] = None
    """Write the table to this file as Markdown."""
    training: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Instead of the benchmarks, profile training steps of a synthetic capture or, with --run, of a run: the time of
    each operator, the operator events of a step, and the part of a step that uses only one thread."""
    run: Annotated[Path | None, READS, option("RUN", "a synthetic capture")] = None
    """Run folder whose training steps are profiled, with --training. The run is not changed."""
    device: DeviceName = "auto"
    """Device of the training steps that are profiled."""
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Run in less than a minute: fewer repetitions, no whole training steps, no timing of other implementations."""


def run(arguments: Arguments) -> None:
    """Measure the run time of all cases, and print the table."""
    from fourd.benchmarks.cases import cases
    from fourd.benchmarks.gpu_cases import gpu_cases
    from fourd.benchmarks.machine import this_machine
    from fourd.benchmarks.peers import missing_peers
    from fourd.benchmarks.report import Row, markdown, table, to_json
    from fourd.benchmarks.timing import Clock

    console = Terminal()
    machine = this_machine()
    if arguments.run is not None and not arguments.training:
        raise UserError("--run: expected --training beside it, got neither a profile nor a benchmark; add --training")
    console.print(str(machine), soft_wrap=True)
    if arguments.training:
        _profile(arguments, console)
        return
    clock = Clock(seconds=1.0 if arguments.quick else 6.0)
    rows: list[Row] = []
    with ExitStack() as resources, console.status("") as status:
        for case in chain(cases(resources, steps=not arguments.quick), gpu_cases()):
            status.update(case.name)
            rows.append(Row.measure(case, clock, rivals=not arguments.quick))
    console.print(table(rows))
    for name in missing_peers():
        console.print(f"{name} is not installed, so no row compares fourd with {name}.", soft_wrap=True)
    if arguments.json is not None:
        write_text_atomically(arguments.json, to_json(rows, machine))
    if arguments.markdown is not None:
        write_text_atomically(arguments.markdown, markdown(rows, machine))


def _profile(arguments: Arguments, console: Terminal) -> None:
    from fourd.benchmarks.training_profile import profile_training, tables
    from fourd.benchmarks.training_step import synthetic_run
    from fourd.reconstruction.training.run import open_run
    from fourd.rendering.ops.gpu import choose_device

    with ExitStack() as resources:
        run = synthetic_run(resources) if arguments.run is None else open_run(arguments.run)
        config = replace(run.config.train, max_steps=run.config.train.max_steps or 1)
        steps = 6 if arguments.quick else 30
        for table_ in tables(profile_training(run, config, choose_device(arguments.device), steps)):
            console.print(table_)
            console.print()
