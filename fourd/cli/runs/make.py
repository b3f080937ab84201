"""From videos or a capture to a 4D scene: import, check, mattes, plates, carving, training and baking."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from fourd.cli.captures.matte import MatteOptions
from fourd.cli.options import Workers, worker_count
from fourd.cli.training_options import TrainingOptions
from fourd.pipeline.make import make_scene
from fourd.pipeline.stage import Context
from fourd.training.losses.lpips import load_lpips

DEFAULT_SECONDS = 1800.0


@dataclass(frozen=True)
class Arguments:
    """Every stage is cached: the same command resumes after an interruption."""

    capture: tyro.conf.Positional[Path]
    """A capture, or anything that fourd import reads, such as a folder of videos and their calibration."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The .4dv file to write. Results of the stages are kept beside it, in OUT.work/."""
    training: TrainingOptions
    mattes: MatteOptions
    workers: Workers = None


def run(arguments: Arguments) -> None:
    """Run every stage that is not up to date."""
    console = Console()  # stderr is reserved for the one line that reports wrong input
    options = arguments.training
    config = options.train_config(DEFAULT_SECONDS)
    load_lpips(options.lpips_weights)  # report wrong weights before any work
    make_scene(
        arguments.capture,
        arguments.out,
        config,
        arguments.mattes.settings(config.seed),
        Context(console, worker_count(arguments.workers)),
        points_from=options.points_from,
        lpips_weights=options.lpips_weights,
    )
    console.print(
        f"{arguments.out}: written; next: fourd render {arguments.out} --path orbit --out orbit.mp4", soft_wrap=True
    )
