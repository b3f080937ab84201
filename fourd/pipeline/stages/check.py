"""Check: verifies that the files of a capture are complete and consistent."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.pipeline.stage import Artefact, Context, NoSettings, Stage
from fourd.recording.capture.check import check_capture, first_lines
from fourd.recording.capture.video_index import index_capture

MAX_WARNINGS = 20
INPUT_PATTERNS = ("*.yml", "videos.json", "videos/*", "images/*/*", "masks/*/*")
"""Glob patterns that match the input files of a capture, but not the files that fourd writes."""


@dataclass(frozen=True)
class CheckFiles:
    """The capture's folder."""

    capture: Path


def check_stage(capture: Path) -> Stage[CheckFiles, NoSettings]:
    """Create the stage that checks ``capture``."""
    return Stage(
        "check",
        run_check,
        CheckFiles(capture),
        NoSettings(),
        inputs=(Artefact(capture, INPUT_PATTERNS),),
        outputs=(capture,),
    )


def run_check(files: CheckFiles, settings: NoSettings, context: Context) -> None:
    """Index the videos and check all files of the capture. Warnings are logged. Raises UserError for the first
    problem."""
    track = context.track
    index_capture(files.capture, None, track)
    report = check_capture(files.capture, track=track)
    for line in first_lines(report.warnings, MAX_WARNINGS):
        context.log(f"warning: {line}")
    problems = report.problems
    if problems:
        more = f" (and {len(problems) - 1} more; fourd check lists them)" if len(problems) > 1 else ""
        raise UserError(f"{problems[0]}{more}")
