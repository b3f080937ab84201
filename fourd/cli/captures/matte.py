"""Make mattes and clean plates of a capture without any, and a contact sheet to judge them by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro
from rich.console import Console

from fourd.capture.layout import MATTES
from fourd.errors import UserError
from fourd.matting.plates import FOLDER as PLATES
from fourd.matting.stage import SHEET, MatteSettings
from fourd.parallel import core_count
from fourd.pipeline.graph import MASKS, has_masks, stages_to_mattes
from fourd.pipeline.runner import Runner
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.mattes import MatteStageSettings


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
    """Make what is missing and print where it is."""
    views = None if arguments.views is None else tuple(n.strip() for n in arguments.views.split(",") if n.strip())
    method = MatteSettings(arguments.method, arguments.seed, arguments.screen, arguments.rvm)
    settings = MatteStageSettings(views, arguments.frames, method)
    capture, console = arguments.capture, Console()
    masks = has_masks(capture)
    context = Context(Console(stderr=True), processes(arguments.workers))
    Runner(context).run(stages_to_mattes(capture, settings, arguments.plates))
    if masks:
        console.print(f"{capture / MASKS}: found mattes there; none made", soft_wrap=True)
    else:
        console.print(f"{capture / MATTES}: mattes; {capture / SHEET} shows samples to judge them by", soft_wrap=True)
    if arguments.plates:
        console.print(f"{capture / PLATES}: clean plates; pixels never seen are transparent", soft_wrap=True)


def processes(asked: int | None) -> int:
    """Number of processes to work with: as asked, or else one for each core that this one may use."""
    if asked is not None:
        if asked < 1:
            raise UserError(f"--workers: expected at least 1, got {asked}; leave it out for one a core")
        return asked
    return core_count()
