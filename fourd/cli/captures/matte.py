"""Make mattes and clean plates of a capture without any, and a contact sheet to judge them by."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro
from rich.console import Console

from fourd.errors import UserError
from fourd.matting.prepare import Made, make_all
from fourd.matting.selection import Selection
from fourd.matting.stage import MatteSettings
from fourd.parallel import core_count
from fourd.progress import Tracker


@dataclass(frozen=True)
class Arguments:
    """Writes CAPTURE/.fourd/mattes, plates and mattes.png; a second call goes on where the first stopped."""

    capture: tyro.conf.Positional[Path]
    """Folder with images/ or videos/, intri.yml and extri.yml."""
    method: Literal["motion", "chroma", "rvm"] = "motion"
    """motion: by what moves and the agreement of the views, without weights; chroma: before a screen of one
    colour; rvm: Robust Video Matting, whose file --rvm names."""
    screen: str | None = None
    """The screen's colour as R,G,B of 0 to 255; found when not given."""
    rvm: Path | None = None
    """TorchScript file of Robust Video Matting; it runs code, so use one that you trust."""
    views: str | None = None
    """Names of the cameras to use, with commas; all when not given."""
    frames: str | None = None
    """Frames as A:B or A:B:S, B not included; all when not given."""
    workers: int | None = None
    """Processes; as many as there are cores when not given."""
    seed: int = 0
    """Seed of everything random."""
    plates: bool = True
    """Make clean plates too."""


def run(arguments: Arguments) -> None:
    """Make what is missing and say where it is."""
    console = Console(stderr=True)
    views = None if arguments.views is None else tuple(n.strip() for n in arguments.views.split(",") if n.strip())
    selection = Selection(arguments.capture, views, arguments.frames)
    settings = MatteSettings(arguments.method, arguments.seed, arguments.screen, arguments.rvm)
    made = make_all(selection, settings, processes(arguments.workers), Tracker(console).track, arguments.plates)
    for line in told(arguments.capture, made):
        Console().print(line, soft_wrap=True)


def told(capture: Path, made: Made) -> Iterator[str]:
    """What was made, for a person."""
    if made.brought:
        yield f"{capture / 'masks'}: found mattes there; none made"
    else:
        yield f"{made.mattes}: mattes of {made.frames} frames made now, the rest found done"
        yield f"{made.sheet}: look at this picture to judge them"
    if made.plates is not None:
        yield f"{made.plates}: clean plates; holes, where the subject always was, are transparent"


def processes(asked: int | None) -> int:
    """Number of processes to work with: as asked, or else one for each core that this one may use."""
    if asked is not None:
        if asked < 1:
            raise UserError(f"--workers: expected at least 1, got {asked}; leave it out for one a core")
        return asked
    return core_count()
