"""Train a 4D scene on a calibrated capture with mattes."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from fourd.base.errors import UserError, command_line
from fourd.base.processes import locked_folder
from fourd.base.progress import Terminal
from fourd.base.storage import StorageUrl
from fourd.cli.help import RARE
from fourd.cli.locations import CaptureLocation
from fourd.cli.options import Workers, worker_count
from fourd.cli.outputs import WRITES
from fourd.cli.training_options import TrainingOptions
from fourd.reconstruction.training.run_layout import SOURCE

if TYPE_CHECKING:
    from fourd.pipeline.runner import AnyStage
    from fourd.reconstruction.training.config import TrainConfig
    from fourd.reconstruction.training.distributed.process_group import ProcessGroup


@dataclass(frozen=True)
class Arguments:
    """Before training, the command adjusts the cameras, carves the initial points and makes initial background points,
    if the options require it. Use --resume to continue interrupted training. To train with several processes, write:
    torchrun --nproc-per-node 2 -m fourd train CAPTURE -o RUN."""

    capture: CaptureLocation
    """Capture folder: images/ or videos/, intri.yml, extri.yml, and masks/ or the output of fourd matte. A URL such as
    s3://bucket/capture is copied to RUN/source/."""
    out: Annotated[Path, WRITES, tyro.conf.arg(aliases=["-o"])]
    """Run folder to write: a new folder, or an existing run with --resume."""
    training: TrainingOptions
    resume: bool = False
    """Continue training from the newest checkpoint. Of the run's options, only the budget (--max-steps, --max-seconds)
    may be changed."""
    workers: Annotated[Workers, RARE] = None


def run(arguments: Arguments) -> None:
    """Run the stages that training needs, then train."""
    from fourd.reconstruction.training.distributed.process_group import join_process_group
    from fourd.reconstruction.training.run import remove_leftovers

    # The first process (rank 0) prepares the run. The other processes only take part in training.
    with join_process_group() as group, locked_folder(arguments.out) if group.is_first else nullcontext():
        if group.is_first:
            remove_leftovers(arguments.out)
        _run_stages(arguments, group)


def _run_stages(arguments: Arguments, group: ProcessGroup) -> None:
    from fourd.base.configs import to_yaml
    from fourd.base.version import __version__
    from fourd.cli.training_options import print_summary
    from fourd.pipeline.fetch import fetch_stage, fetched_path
    from fourd.pipeline.graphs.run import RunRequest, stages_to_resume, stages_to_run
    from fourd.pipeline.make import require_new_run
    from fourd.pipeline.report.summary import summarize_run
    from fourd.pipeline.runner import Runner
    from fourd.pipeline.stage import Context
    from fourd.pipeline.stages.train import TrainFiles, require_divisible
    from fourd.reconstruction.training.cameras.selection import with_test_split
    from fourd.reconstruction.training.losses.lpips import load_lpips
    from fourd.reconstruction.training.run import open_run
    from fourd.rendering.ops.gpu import choose_device

    # Progress is printed to stdout, because stderr is reserved for the one-line error message.
    console = Terminal(quiet=not group.is_first)
    options = arguments.training
    context = Context(console, worker_count(arguments.workers), group, options.device)
    # The LPIPS weights are loaded here so that invalid weights are reported before any stage runs.
    load_lpips(options.lpips_weights)
    choose_device(options.device)  # A missing GPU is reported before any stage runs.
    given, copies = arguments.capture, arguments.out / SOURCE
    capture = given if isinstance(given, Path) else fetched_path(given, copies)
    files = TrainFiles(capture, arguments.out, options.lpips_weights)
    if arguments.resume:
        config = _resumed_config(options, open_run(arguments.out).config.train)
    else:
        config = options.train_config()
        if group.is_first:
            require_new_run(arguments.out)
    group.require_same("config", f"fourd {__version__}\n{to_yaml(config)}")
    require_divisible(config, group)
    stages: tuple[AnyStage, ...]
    if arguments.resume or not group.is_first:
        stages = stages_to_resume(files, config)
    else:
        if isinstance(given, StorageUrl):
            Runner(context).run([fetch_stage(given, copies)])
        config = with_test_split(config, capture, context.log)
        request = RunRequest(
            capture,
            arguments.out,
            config,
            options.points_from,
            options.lpips_weights,
            accept_mattes=options.accept_mattes,
        )
        stages = stages_to_run(request)
    Runner(context).run(stages)
    if group.is_first:
        print_summary(summarize_run(arguments.out), console)
    console.print(f"{arguments.out}: trained; next: {command_line('fourd', 'view', arguments.out)}", soft_wrap=True)


def _resumed_config(options: TrainingOptions, config: TrainConfig) -> TrainConfig:
    """Return the run's config with the training budget of the options.

    Without a budget option, the config keeps its budget.
    """
    from fourd.base.configs import to_yaml

    overlaid = options.overlay(config)
    if options.max_steps is not None or options.max_seconds is not None:
        overlaid = replace(overlaid, max_steps=options.max_steps, max_seconds=options.max_seconds)
    unchanged = replace(overlaid, max_steps=config.max_steps, max_seconds=config.max_seconds)
    if unchanged != config:
        lines = zip(to_yaml(unchanged).splitlines(), to_yaml(config).splitlines(), strict=False)
        changed = next((new.strip() for new, old in lines if new != old), "another config")
        raise UserError(
            f"--resume: expected the options of the run, except for the budget, got {changed}; train in a new folder"
        )
    return overlaid
