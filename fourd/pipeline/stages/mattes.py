"""Mattes: foreground masks of every image, and a contact sheet to judge them by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.capture import open_capture
from fourd.capture.video_index import index_capture
from fourd.matting.contact_sheet import write_contact_sheet
from fourd.matting.selection import Selection
from fourd.matting.sequence import SHEET, MatteSettings, make_mattes
from fourd.pipeline.stage import Artefact, Context, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS


@dataclass(frozen=True)
class MatteFiles:
    """The capture's folder; mattes go to ``.fourd/mattes/`` in it."""

    capture: Path


@dataclass(frozen=True)
class MatteStageSettings:
    """Views and frames to make mattes of, and the method."""

    views: tuple[str, ...] | None
    frames: str | None
    mattes: MatteSettings


def mattes_stage(capture: Path, settings: MatteStageSettings) -> Stage[MatteFiles, MatteStageSettings]:
    """Make the mattes of ``capture``, which has no masks/ of its own."""
    return Stage(
        "mattes",
        run_mattes,
        MatteFiles(capture),
        settings,
        inputs=(Artefact(capture, INPUT_PATTERNS),),
        outputs=(capture / SHEET,),
    )


def run_mattes(files: MatteFiles, settings: MatteStageSettings, context: Context) -> None:
    """Make missing mattes, then the contact sheet. Files of an earlier call with the same settings are kept."""
    selection = Selection(files.capture, settings.views, settings.frames)
    index_capture(files.capture, settings.views, context.track)
    made = make_mattes(selection, settings.mattes, context.workers, context.track)
    context.log(f"{files.capture}: mattes of {made} frames made; mattes of the other frames are kept")
    sheet = files.capture / SHEET
    if made or not sheet.exists():
        views = None if settings.views is None else list(settings.views)
        write_contact_sheet(
            open_capture(files.capture, views=views, frames=settings.frames), sheet, track=context.track
        )
