"""Mattes: makes foreground mattes of all images, and a contact sheet with which the user can check the mattes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.capture import Capture, open_capture
from fourd.capture.layout import DERIVED
from fourd.capture.video_index import index_capture
from fourd.carving.matte_quality import measure_mattes
from fourd.matting.contact_sheet import write_contact_sheet
from fourd.matting.output import SHEET
from fourd.matting.selection import Selection
from fourd.matting.sequence import MatteSettings, make_mattes
from fourd.pipeline.stage import Artefact, Context, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.stages.edited_mattes import kept_if_edited

QUALITY = DERIVED / "matte_quality.json"
"""JSON file that records how well the mattes agree with visual hulls: three numbers for each camera in each of a few
frames; see ``fourd.carving.matte_quality.MatteQuality``."""


@dataclass(frozen=True)
class MatteFiles:
    """The capture folder. The mattes are written to ``.fourd/mattes/`` in it."""

    capture: Path


@dataclass(frozen=True)
class MatteStageSettings:
    """Selected views and frames, and the settings of matting."""

    views: tuple[str, ...] | None
    frames: str | None
    mattes: MatteSettings


def mattes_stage(capture: Path, settings: MatteStageSettings) -> Stage[MatteFiles, MatteStageSettings]:
    """Create the stage that makes mattes for ``capture``, which must not contain masks from the user in masks/."""
    return Stage(
        "mattes",
        run_mattes,
        MatteFiles(capture),
        settings,
        inputs=(Artefact(capture, INPUT_PATTERNS),),
        outputs=(capture / SHEET,),
    )


def run_mattes(files: MatteFiles, settings: MatteStageSettings, context: Context) -> None:
    """Make the missing mattes, and then the contact sheet. Mattes that an earlier call made with the same settings are
    kept."""
    selection = Selection(files.capture, settings.views, settings.frames)
    index_capture(files.capture, settings.views, context.track)
    with kept_if_edited(files.capture, context.log):
        made = make_mattes(selection, settings.mattes, context.workers, context.track)
    context.log(f"{files.capture}: made mattes of {made} frames; kept the mattes of the other frames")
    sheet = files.capture / SHEET
    if made or not sheet.exists():
        views = None if settings.views is None else list(settings.views)
        with open_capture(files.capture, views=views, frames=settings.frames) as capture:
            write_quality(capture, context)
            write_contact_sheet(capture, sheet, track=context.track)


def write_quality(capture: Capture, context: Context) -> None:
    """Compare the mattes of a few frames with visual hulls, and write the results to QUALITY. If the visual
    hull of the other views covers only a small fraction of a matte, log a warning for this matte."""
    quality = measure_mattes(capture, track=context.track)
    if quality is None:
        return
    quality.save(capture.path / QUALITY)
    for line in quality.warnings():
        context.log(line)
