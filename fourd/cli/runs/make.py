"""Make a 4D scene from videos or a capture: import, check, mattes, plates, carving, training and baking."""

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
SOURCE_HELP = (
    "A capture, or any input of fourd import, such as a folder of videos. To set time offsets, the scale or the "
    "calibration, run fourd import first."
)


@dataclass(frozen=True)
class Arguments:
    """The result of every stage is cached. Run an interrupted command again to resume it."""

    capture: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="VIDEOS|CAPTURE", help=SOURCE_HELP)]]
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The .4dv file to write. Intermediate results of scene.4dv are kept in the folder scene.work/ beside the file."""
    training: TrainingOptions
    mattes: MatteOptions
    workers: Workers = None


def run(arguments: Arguments) -> None:
    """Run all stages that are not up to date."""
    # Progress is printed to stdout, because stderr is reserved for the one-line error message.
    console = Console()
    options = arguments.training
    config = options.train_config(DEFAULT_SECONDS)
    # Loading the LPIPS weights here reports invalid weights before any stage runs.
    load_lpips(options.lpips_weights)
    make_scene(
        arguments.capture,
        arguments.out,
        config,
        arguments.mattes.settings(config.seed),
        Context(console, worker_count(arguments.workers)),
        points_from=options.points_from,
        lpips_weights=options.lpips_weights,
        accept_mattes=options.accept_mattes,
    )
    console.print(
        f"{arguments.out}: written; next: fourd render {arguments.out} --path orbit --out orbit.mp4", soft_wrap=True
    )
