"""Search for a recording of a calibration board beside the videos of a subject."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.files import list_folder
from fourd.base.progress import Log
from fourd.recording.importing.folders import find_frames

BOARD_NAME = "board.toml"
RECORDINGS = ("board", "boards", "board_videos", "calibration", "calibration_videos")
"""Names of folders beside ``board.toml`` that contain its recording."""


@dataclass(frozen=True)
class BoardRecording:
    """A calibration board and the videos in which it moves.

    Attributes:
        board: the TOML file that describes the board.
        videos: the folder with one video, or one folder of images, for each camera.
    """

    board: Path
    videos: Path


def find_board_recording(source: Path, log: Log) -> BoardRecording | None:
    """Find the recording of a calibration board that belongs to the videos in ``source``, or return None.

    ``board.toml`` may be in ``source`` or in the folder that contains ``source``, and the recording beside it in a
    folder of RECORDINGS. Or both are in one folder, in ``source`` or beside it, of any name. A board without a
    recording is logged.

    Raises:
        UserError: if there are several recordings.
    """
    places = [source, source.absolute().parent] if source.is_dir() else []
    folders = [*places, *(place / name for place in places for name in list_folder(place))]
    boards = [folder / BOARD_NAME for folder in folders if (folder / BOARD_NAME).is_file()]
    found: dict[Path, BoardRecording] = {}
    for board in boards:
        videos = _recording_beside(board, source)
        if videos is not None:
            found[videos.resolve()] = BoardRecording(board, videos)
    if len(found) > 1:
        listed = ", ".join(str(each.videos) for each in found.values())
        raise UserError(
            f"{source}: expected one recording of a calibration board, got {listed}; calibrate with one of them (fourd "
            "calibrate), and name the result with --calibration"
        )
    if boards and not found:
        log(f"{boards[0]}: no recording of this board beside it, for example in {boards[0].parent / RECORDINGS[0]}/")
    return next(iter(found.values()), None)


def _recording_beside(board: Path, source: Path) -> Path | None:
    """Return the folder with the recording of a board: a folder of RECORDINGS beside the board's file, or the folder of
    the file itself unless it contains ``source``."""
    folder = board.parent
    candidates = [folder / name for name in RECORDINGS]
    if not source.resolve().is_relative_to(folder.resolve()):
        candidates.append(folder)
    for place in candidates:
        if place.is_dir() and place.resolve() != source.resolve() and _has_frames(place):
            return place
    return None


def _has_frames(folder: Path) -> bool:
    try:
        return bool(find_frames(folder))
    except (UserError, OSError):
        return False
