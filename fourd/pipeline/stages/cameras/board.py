"""Calibrate: calibrates the cameras of videos from a recording of a calibration board."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage
from fourd.pipeline.stages.import_ import PATTERNS
from fourd.recording.board_calibration.calibrate import CalibrationSettings, calibrate_rig
from fourd.recording.board_calibration.search import BoardRecording
from fourd.recording.boards import CalibrationBoard, read_board
from fourd.recording.importing.given_calibration import REPORT


@dataclass(frozen=True)
class BoardFiles:
    """The board, the folder of its videos, and the folder of the new calibration."""

    recording: BoardRecording
    calibration: Path


@dataclass(frozen=True)
class BoardSettings:
    """The board that the videos show."""

    board: CalibrationBoard


def board_stage(recording: BoardRecording, calibration: Path) -> Stage[BoardFiles, BoardSettings]:
    """Create the stage that calibrates from ``recording`` and writes the folder ``calibration``. Raises UserError if
    the board's file is invalid."""
    return Stage(
        "calibrate",
        run_board,
        BoardFiles(recording, calibration),
        BoardSettings(read_board(recording.board)),
        inputs=(Artefact(recording.videos, PATTERNS),),
        outputs=(calibration / REPORT,),
        leftovers=(Leftovers(calibration),),
    )


def run_board(files: BoardFiles, settings: BoardSettings, context: Context) -> None:
    """Calibrate the cameras, unless an earlier call has done so."""
    log, recording = context.log, files.recording
    if (files.calibration / REPORT).is_file():
        return
    log(f"{recording.videos}: recording of the calibration board {recording.board}")
    calibrate_rig(
        recording.videos,
        files.calibration,
        CalibrationSettings(settings.board, recording.board),
        log=log,
        warn=lambda line: log(f"warning: {line}"),
        track=context.track,
    )
