"""Carve coloured initial points for each frame from a capture's mattes, and compute the scene's bounds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from fourd.base.errors import UserError
from fourd.base.processes import locked_folder
from fourd.base.progress import Terminal
from fourd.cli.options import CapturePath, SelectionOptions, Workers, check_hull_shares, describe, option, worker_count
from fourd.cli.outputs import WRITES

FOLDER = Path(".fourd") / "hulls"


@dataclass(frozen=True)
class Arguments:
    """The command writes the points of each frame to FRAME.ply and the bounds to bounds.json. Run an interrupted
    command again to resume it.
    """

    capture: CapturePath
    """Capture folder: images/ or videos/, intri.yml, extri.yml, and masks/ or the output of fourd matte."""
    selection: SelectionOptions
    out: Annotated[Path | None, WRITES, tyro.conf.arg(aliases=["-o"]), option("DIR", "CAPTURE/.fourd/hulls")] = None
    """Folder to write the points to."""
    points: int = 65536
    """Maximum number of points per frame."""
    agreement: Annotated[
        float,
        describe(
            "Minimum share of mattes that must contain a point, in (0, 1]. Views that do not see the point are",
            "ignored. Choose a lower share if mattes have holes.",
        ),
    ] = 0.95
    least_views: Annotated[
        float,
        describe(
            "Minimum share of all views that must see a point, in (0, 1]. Choose a lower share if each camera sees",
            "only a part of the scene. At least three views must see every point, because two views give false points.",
            "If the capture has fewer than three views, all views must see every point.",
        ),
    ] = 0.5
    trim: bool = True
    """Remove protruding parts of the visual hull. The remaining hull still covers all mattes. With --no-trim, the
    points cover the whole visual hull."""
    inset: float = 0.0
    """Distance by which points are moved into the visual hull, in multiples of the mean distance between neighbouring
    points. Training moves points inwards, because they are drawn as discs, and discs around points on the surface
    extend beyond the surface. With a value above 0, points start nearer to their trained positions."""
    scale: float = 1.0
    """Scale factor of the images. A factor of 0.5 halves width and height."""
    seed: int = 0
    """Random seed for the order in which points are stored."""
    accept_mattes: bool = False
    """Carve even if the visual hull covers less than a third of the area of the mattes."""
    workers: Workers = None


def run(arguments: Arguments) -> None:
    """Carve every frame and print the bounds."""
    from fourd.pipeline.runner import Runner
    from fourd.pipeline.stage import Context
    from fourd.pipeline.stages.points.carve import CarveStageSettings, carve_stage
    from fourd.reconstruction.carving import read_bounds
    from fourd.reconstruction.carving.sequence import BOUNDS_NAME
    from fourd.reconstruction.training.cameras.selection import DataSelection

    _check(arguments)
    capture, selection = arguments.capture, arguments.selection
    folder = arguments.out if arguments.out is not None else capture / FOLDER
    settings = CarveStageSettings(
        DataSelection(selection.names, frames=selection.frames, image_scale=arguments.scale),
        arguments.points,
        arguments.agreement,
        arguments.least_views,
        arguments.trim,
        arguments.inset,
        arguments.seed,
        arguments.accept_mattes,
    )
    console = Terminal(stderr=True)
    before = _points(folder)
    if before and not (folder / BOUNDS_NAME).is_file():
        raise UserError(
            f"{folder}: expected a new folder or points of fourd carve, got other files such as {min(before)}; name "
            "another folder"
        )
    with locked_folder(folder):
        Runner(Context(console, worker_count(arguments.workers))).run([carve_stage(capture, folder, settings)])
    after = _points(folder)
    replaced = sum(after.get(name) != state for name, state in before.items())
    if replaced:
        console.print(
            f"{folder}: the points of {replaced} frames were made again, because settings or files have changed",
            soft_wrap=True,
        )
    bounds = read_bounds(folder)
    lower, upper = (", ".join(f"{value:.4g}" for value in corner) for corner in (bounds.lower, bounds.upper))
    console.print(
        f"{folder}: at most {arguments.points} points per frame; bounds in world units: ({lower}) to ({upper})",
        soft_wrap=True,
    )


def _points(folder: Path) -> dict[str, int]:
    """Return the time of the last change in nanoseconds of each points file in a folder, by its name."""
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("[0-9]" * 6 + ".ply")}


def _check(arguments: Arguments) -> None:
    if arguments.points < 1:
        raise UserError(f"--points: expected at least 1, got {arguments.points}; the default is 65536")
    if arguments.inset < 0:
        raise UserError(f"--inset: expected 0 or more, got {arguments.inset:g}; the default is 0")
    check_hull_shares(arguments.agreement, arguments.least_views)
