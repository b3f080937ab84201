"""Make mattes and clean plates of a capture without masks, and a contact sheet to judge them by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from fourd.capture.layout import MATTES
from fourd.cli.options import SelectionOptions, Workers, describe, option, worker_count
from fourd.matting.plates import FOLDER as PLATES
from fourd.matting.sequence import SHEET, MatteSettings
from fourd.pipeline.capture_graph import MASKS, has_masks, stages_to_mattes
from fourd.pipeline.runner import Runner
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.mattes import MatteStageSettings


@dataclass(frozen=True)
class MatteOptions:
    """How mattes are made of a capture without masks."""

    method: Annotated[
        Literal["motion", "chroma", "rvm"],
        describe(
            "motion: from motion and the agreement of views, needs no weights. chroma: from a screen of one colour.",
            "rvm: by the network Robust Video Matting, whose file --rvm names.",
        ),
    ] = "motion"
    screen: Annotated[str | None, option("R,G,B", "estimated per camera")] = None
    """Colour of the screen, 0 to 255 each, for --method chroma."""
    rvm: Annotated[Path | None, option("FILE", "none")] = None
    """TorchScript file of Robust Video Matting, for --method rvm. It executes code: use only files that you trust."""

    def settings(self, seed: int) -> MatteSettings:
        """Settings of the matting stage."""
        return MatteSettings(self.method, seed, self.screen, self.rvm)


@dataclass(frozen=True)
class Arguments:
    """Writes mattes/, plates/ and mattes.png in CAPTURE/.fourd; an interrupted command resumes."""

    capture: tyro.conf.Positional[Path]
    """Folder with images/ or videos/, intri.yml and extri.yml."""
    selection: SelectionOptions
    mattes: MatteOptions
    workers: Workers = None
    seed: int = 0
    """Random seed."""
    plates: bool = True
    """Make clean plates too."""


def run(arguments: Arguments) -> None:
    """Make what is missing and print where it is."""
    capture, selection = arguments.capture, arguments.selection
    settings = MatteStageSettings(selection.names, selection.frames, arguments.mattes.settings(arguments.seed))
    context = Context(Console(stderr=True), worker_count(arguments.workers))
    masks = has_masks(capture)
    Runner(context).run(stages_to_mattes(capture, settings, arguments.plates))
    lines = [
        f"{capture / MASKS}: the capture has masks; no mattes made"
        if masks
        else f"{capture / MATTES}: mattes; {capture / SHEET} shows samples of them"
    ]
    if arguments.plates:
        lines.append(f"{capture / PLATES}: clean plates, transparent where no frame shows the background")
    for line in lines:
        Console().print(line, soft_wrap=True)
