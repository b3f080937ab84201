"""Carve a capture's mattes into first points of each frame, with colours, and the scene's bounds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from fourd.carving import read_bounds
from fourd.cli.captures.matte import processes
from fourd.errors import UserError
from fourd.pipeline.runner import Runner
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.carve import CarveStageSettings, carve_stage
from fourd.training.cameras.selection import DataSelection

FOLDER = Path(".fourd") / "hulls"


@dataclass(frozen=True)
class Arguments:
    """Writes FRAME.ply and bounds.json; a second call goes on where the first stopped."""

    capture: tyro.conf.Positional[Path]
    """Folder with images/, masks/, intri.yml and extri.yml."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the points; CAPTURE/.fourd/hulls when not given."""
    points: int = 65536
    """Points of each frame."""
    agreement: float = 0.95
    """Share of the views seeing a point that must hold it, in (0, 1]; lower it where mattes have holes."""
    least_views: float = 0.5
    """Share of all views that must see a point, in (0, 1]; lower it where cameras see parts of the scene.
    Never fewer than three views see it, or all where there are fewer: what two see alone is full of ghosts."""
    views: str | None = None
    """Names of the cameras to use, with commas; all when not given."""
    frames: str | None = None
    """Frames as A:B or A:B:S, B not included; all when not given."""
    scale: float = 1.0
    """Scale of the images; 0.5 halves both sides."""
    seed: int = 0
    """Seed of the points' order."""
    workers: int | None = None
    """Processes; as many as there are cores when not given."""


def run(arguments: Arguments) -> None:
    """Carve every frame and say where the scene is."""
    _check(arguments)
    views = None if arguments.views is None else tuple(n.strip() for n in arguments.views.split(",") if n.strip())
    folder = arguments.out if arguments.out is not None else arguments.capture / FOLDER
    selection = DataSelection(views, frames=arguments.frames, image_scale=arguments.scale)
    settings = CarveStageSettings(
        selection, arguments.points, arguments.agreement, arguments.least_views, arguments.seed
    )
    console = Console(stderr=True)
    Runner(Context(console, processes(arguments.workers))).run([carve_stage(arguments.capture, folder, settings)])
    bounds = read_bounds(folder)
    lower, upper = (", ".join(f"{value:.4g}" for value in corner) for corner in (bounds.lower, bounds.upper))
    console.print(
        f"{folder}: {arguments.points} points a frame; bounds ({lower}) to ({upper}), world units", soft_wrap=True
    )


def _check(arguments: Arguments) -> None:
    if arguments.points < 1:
        raise UserError(f"--points: expected at least 1, got {arguments.points}; 65536 is the usual number")
    for name in ("agreement", "least_views"):
        share = getattr(arguments, name)
        if not 0 < share <= 1:
            raise UserError(f"--{name.replace('_', '-')}: expected a share in (0, 1], got {share:g}")
