"""Calibrate a rig of cameras from videos of a moving calibration board."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.text import Text

from fourd.base.errors import UserError, command_line
from fourd.base.files import remove_unfinished_folder
from fourd.base.processes import locked_folder
from fourd.base.progress import Log, Terminal, Tracker
from fourd.cli.options import Frames, option, parse_offsets
from fourd.cli.outputs import READS, WRITES_WHOLE_FOLDER, Writes

VIDEOS_HELP = (
    "Folder with one video per camera, or one folder of images per camera. "
    "The videos or images show a moving calibration board."
)
OUT_HELP = (
    "Folder to write: intri.yml, extri.yml, report.json and rig.png. An earlier calibration is kept as CALIBRATION.1."
)
INTRINSICS_HELP = (
    "Known intrinsics and distortion, which are not changed: a folder with intri.yml, or a TOML file of Caliscope "
    "(camera_array.toml), Anipose or Pose2Sim."
)
FLOOR_HELP = (
    "Number of a frame in which the board lies on the floor. The world's origin is then a corner of the board, "
    "and z points up."
)
OFFSET_HELP = (
    "Number of frames by which events appear later in the video of camera CAM than in the other videos. "
    "Example for two cameras: cam02=3,cam05=-1."
)
UNLESS_PRINTED = "(required, except with --print-board)"
PRINT_HELP = "Print the board to a PDF file at true scale, and stop. VIDEOS and -o are not needed."


@dataclass(frozen=True)
class Arguments:
    """The command writes intrinsics, distortion and poses in metres. fourd import and fourd make read the calibration
    with --calibration.
    """

    board: Annotated[Path, READS]
    """TOML file that describes the board."""
    videos: tyro.conf.Positional[
        Annotated[
            Path | None, READS, tyro.conf.arg(metavar="VIDEOS", help=VIDEOS_HELP, help_behavior_hint=UNLESS_PRINTED)
        ]
    ] = None
    out: Annotated[
        Path | None,
        WRITES_WHOLE_FOLDER,
        tyro.conf.arg(aliases=["-o"], metavar="CALIBRATION", help=OUT_HELP, help_behavior_hint=UNLESS_PRINTED),
    ] = None
    intrinsics: Annotated[Path | None, READS, option("FILE", "estimated from the board", INTRINSICS_HELP)] = None
    floor_frame: Annotated[int | None, option("N", "axes of the first camera", FLOOR_HELP)] = None
    frames: Frames = None
    offset: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="CAM=FRAMES", help=OFFSET_HELP, help_behavior_hint="(repeatable)"),
    ] = field(default=())
    print_board: Annotated[Path | None, Writes(suffixes=(".pdf",)), option("FILE.pdf", "none", PRINT_HELP)] = None
    page: str = "A4"
    """Page size for --print-board: A4, A3, A2, letter, or WIDTHxHEIGHT in millimetres."""


def run(arguments: Arguments) -> None:
    """Calibrate the rig, or write a PDF file of the board for printing."""
    from fourd.recording.board_calibration.calibrate import CalibrationSettings, calibrate_rig
    from fourd.recording.board_calibration.printing import print_board
    from fourd.recording.boards import read_board

    console = Terminal(stderr=True)
    board = read_board(arguments.board)
    if arguments.print_board is not None:
        _check_unused("--print-board", arguments.videos, arguments.out)
        size = print_board(arguments.print_board, board, arguments.page)
        sides = "two sides" if board.double_sided else "one side"
        line = f"{arguments.print_board}: {board.describe()}, {sides}, page {size[0]:g} x {size[1]:g} mm"
        console.print(Text(line), soft_wrap=True)
        return
    if arguments.videos is None or arguments.out is None:
        missing = "VIDEOS" if arguments.videos is None else "-o CALIBRATION"
        raise UserError(f"expected VIDEOS --board BOARD.toml -o CALIBRATION, got no {missing}; add it")

    def log(line: str) -> None:
        console.print(Text(line), soft_wrap=True)

    def warn(line: str) -> None:
        console.print(Text("warning: ", "yellow").append(line, "default"), soft_wrap=True)

    settings = CalibrationSettings(
        board,
        arguments.board,
        arguments.intrinsics,
        arguments.frames,
        arguments.floor_frame,
        parse_offsets(arguments.offset),
    )
    with locked_folder(arguments.out):
        remove_unfinished_folder(arguments.out)
        with _kept_calibration(arguments.out, log):
            calibrate_rig(arguments.videos, arguments.out, settings, log=log, warn=warn, track=Tracker(console).track)
    text = f"next: {command_line('fourd', 'import', 'VIDEOS', 'CAPTURE', '--calibration', arguments.out)}"
    Terminal().print(Text(f"{arguments.out}: written; {text}"), soft_wrap=True)


@contextmanager
def _kept_calibration(out: Path, log: Log) -> Iterator[None]:
    """Keep an earlier calibration as OUT.1, OUT.2 and so on, if the block replaces it."""
    from fourd.pipeline.work.kept import copy_linked, next_kept
    from fourd.recording.board_calibration.calibrate import REPORT, check_out

    kept = next_kept(out)
    if not (out / REPORT).is_file():
        yield
        return
    check_out(out)
    copy_linked(out, kept)
    try:
        yield
    except BaseException:
        shutil.rmtree(kept, ignore_errors=True)
        raise
    log(f"{out}: replaced; the earlier calibration is kept as {kept}")


def _check_unused(option_name: str, *values: Path | None) -> None:
    for value in values:
        if value is not None:
            raise UserError(f"{option_name}: expected no VIDEOS and no -o, got {value}; remove it")
