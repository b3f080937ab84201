"""Repair: corrects a calibration with large residuals (distances of feature matches from their epipolar lines). A
correction is used only if it reduces the residuals of held-out matches.

The given capture is not changed. The corrected capture is a new folder with corrected calibration files and with links
to the other files of the given capture.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.limits import read_json
from fourd.pipeline.stage import Artefact, Context, Leftovers, NoSettings, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.workload import Workload
from fourd.recording.calibration.adjustment.repair import Repair, repair_cameras
from fourd.recording.calibration.checks.agreement import CaptureMatches, assess_agreement, is_disagreeing, match_capture
from fourd.recording.capture.calibration import require_calibration, write_calibration
from fourd.recording.capture.layout import DERIVED, EXTRINSICS_NAME, INTRINSICS_NAME, MATTES, link_entries
from fourd.recording.matting.contours import find_foreign_mattes
from fourd.recording.sync.lateness import find_late_cameras

RESULT = "repair.json"
MAX_MEDIAN_PX = 1.0
"""Median residual in pixels above which corrections of the calibration are tried."""
MIN_SHARE = 0.5
"""Corrections of the calibration are also tried if less than this fraction of the feature matches is within 3 pixels of
the epipolar lines."""


@dataclass(frozen=True)
class RepairFiles:
    """The given capture, and the new folder for the corrected capture and repair.json."""

    capture: Path
    repaired: Path


def repair_stage(capture: Path, repaired: Path) -> Stage[RepairFiles, NoSettings]:
    """Create the stage that corrects the calibration of ``capture`` in the new folder ``repaired``."""
    return Stage(
        "repair",
        run_repair,
        RepairFiles(capture, repaired),
        NoSettings(),
        inputs=(Artefact(capture, INPUT_PATTERNS),),
        outputs=(repaired / RESULT,),
        leftovers=(Leftovers(repaired),),
        expected_s=_expected_s,
    )


def _expected_s(settings: NoSettings, workload: Workload) -> float:
    return workload.matching_s()


def repaired_capture(capture: Path, repaired: Path) -> Path:
    """Return the corrected capture if :func:`run_repair` wrote one, otherwise ``capture``.

    Raises UserError if repair.json is missing or invalid.
    """
    path = repaired / RESULT
    try:
        content = read_json(path)
    except (OSError, ValueError):
        content = None
    is_changed = content.get("changed") if isinstance(content, dict) else None
    if not isinstance(is_changed, bool):
        raise UserError(f"{path}: expected the result of a repair, got other content; delete the file")
    return repaired if is_changed else capture


def run_repair(files: RepairFiles, settings: NoSettings, context: Context) -> None:
    """Match features between the images, and write a corrected capture if the residuals are large and a correction
    reduces them.

    Warnings are logged for cameras whose videos start late, and for mattes that do not belong to the images.

    Raises:
        UserError: if the calibrations of two cameras are swapped, or a view is upside down.
    """
    found = match_capture(files.capture, context.track)
    agreement = assess_agreement(files.capture, found)
    if agreement.mixups:
        raise UserError(agreement.mixups[0])
    log, is_changed = context.log, False
    for line in (
        *find_late_cameras(files.capture, context.track),
        *find_foreign_mattes(files.capture, context.track),
    ):
        log(f"warning: {line}")
    score = agreement.score
    if score is None:
        log(f"calibration: not checked, because only {agreement.matches} points match between the cameras")
    elif score.median_px <= MAX_MEDIAN_PX and score.share >= MIN_SHARE:
        log(f"calibration: {score} of their epipolar lines; no correction is needed")
    else:
        log(f"calibration: {score} of their epipolar lines; trying corrections")
        repair = repair_cameras(found.cameras, found.matches)
        # The correction is discarded if most residuals remain large, because the calibration then probably belongs to
        # other cameras.
        is_changed = repair.is_changed and not is_disagreeing(repair.after)
        for trial in repair.trials:
            kept = "kept" if trial.is_kept else "not kept"
            log(f"calibration: {trial.name}: {trial.score} (held-out matches), {kept}")
        if is_changed:
            _write_repaired(files, found, repair)
            log(f"calibration: before {repair.before}; after {repair.after}; corrected: {files.repaired}")
            if (files.capture / MATTES).is_dir():
                log(f"calibration: mattes in {files.capture / MATTES} do not fit the correction and are made again")
        else:
            log("calibration: not changed, because no correction makes the residuals of held-out matches small")
        for line in () if is_changed else agreement.warnings:
            log(f"warning: {line}")
    write_text_atomically(files.repaired / RESULT, json.dumps({"changed": is_changed}) + "\n")


def _write_repaired(files: RepairFiles, found: CaptureMatches, repair: Repair) -> None:
    """Link the files of the capture, and write the corrected calibration."""
    files.repaired.mkdir(parents=True, exist_ok=True)
    own = {INTRINSICS_NAME, EXTRINSICS_NAME, DERIVED.name, RESULT}
    link_entries(files.capture, files.repaired, left_out=own)
    # The corrections keep the distances between the cameras, and thus the unit.
    unit = require_calibration(files.capture).metres_per_unit
    write_calibration(files.repaired, list(found.names), list(repair.cameras), unit)
