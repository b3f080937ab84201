"""Carve a capture's mattes into first points of each frame, with colours, and the scene's bounds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from fourd.capture import open_capture
from fourd.carving import carve_capture
from fourd.cli.captures.matte import processes
from fourd.errors import UserError
from fourd.progress import Tracker

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
    views = None if arguments.views is None else [name.strip() for name in arguments.views.split(",") if name.strip()]
    capture = open_capture(arguments.capture, views=views, frames=arguments.frames, scale=arguments.scale)
    if not capture.has_masks:
        raise UserError(
            f"{arguments.capture / 'masks'}: expected mattes to carve from, got none; "
            f"make them: fourd matte {arguments.capture}"
        )
    folder = arguments.out if arguments.out is not None else arguments.capture / FOLDER
    bounds = carve_capture(
        capture,
        folder,
        points=arguments.points,
        agreement=arguments.agreement,
        least_views=arguments.least_views,
        seed=arguments.seed,
        track=Tracker(Console(stderr=True)).track,
        workers=processes(arguments.workers),
    )
    lower, upper = (", ".join(f"{value:.4g}" for value in corner) for corner in (bounds.lower, bounds.upper))
    Console(stderr=True).print(
        f"{folder}: {capture.frame_count} frames x {arguments.points} points; "
        f"bounds ({lower}) to ({upper}), world units",
        soft_wrap=True,
    )


def _check(arguments: Arguments) -> None:
    if arguments.points < 1:
        raise UserError(f"--points: expected at least 1, got {arguments.points}; 65536 is the usual number")
    for name in ("agreement", "least_views"):
        share = getattr(arguments, name)
        if not 0 < share <= 1:
            raise UserError(f"--{name.replace('_', '-')}: expected a share in (0, 1], got {share:g}")
