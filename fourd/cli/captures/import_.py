"""Import videos or images, with another program's calibration or without one, as a capture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.text import Text

from fourd.base.errors import UserError, command_line
from fourd.base.files import resolved
from fourd.base.processes import locked_folder
from fourd.base.progress import Terminal, Tracker
from fourd.base.storage import local_path
from fourd.cli.help import RARE
from fourd.cli.options import OFFSET_HELP, SOUNDTRACK_HELP, FramesPerSecond, describe, option, parse_offsets
from fourd.cli.outputs import READS, require_distinct
from fourd.recording.capture.frame_rate import check_rate
from fourd.recording.import_choices import FORMAT_NAMES, CalibratedFrames, PairBy, PrincipalPointMode, SyncMethod

if TYPE_CHECKING:
    from fourd.recording.calibration.chessboard import Board
    from fourd.recording.calibration.scale import Distance
    from fourd.recording.importing.importer import ImportOptions
    from fourd.recording.importing.time_offsets import SoundPosition

WORDS_HELP = (
    f"FORMAT: {', '.join(FORMAT_NAMES)}; detected if omitted. SRC: input folder or file. OUT: capture folder to create."
)

SCALE_HELP = (
    "CAM,CAM=METRES: distance between the optical centres of two cameras. One world unit becomes one metre. "
    "FACTOR, such as 0.5: reduce width and height of video frames by this factor, and scale the calibration."
)
CALIBRATION_HELP = (
    "Calibration of the videos: a folder with intri.yml and extri.yml, for example the output of fourd calibrate. "
    "SRC is then read in the format videos."
)
SOUND_HELP = (
    "Position of the sound source in the world, in metres. Time offsets that are estimated from sound are corrected by "
    "the time that sound travels from this position to the cameras. centre: the point that the cameras face. none: "
    "no correction. auto: centre if the calibration is in metres, otherwise none."
)
BOARD_HELP = (
    "Chessboard in the first frames: numbers of inner corners, and square size in metres. The chessboard sets the "
    "world's origin and axes. If two cameras see the chessboard, it also sets the unit."
)


@dataclass(frozen=True)
class Arguments:
    """The capture links to the files of SRC unless --copy is given. Run an interrupted command again to resume it."""

    words: tyro.conf.Positional[
        Annotated[
            tuple[str, ...],
            tyro.conf.arg(metavar="[FORMAT] SRC OUT", help=WORDS_HELP, help_behavior_hint="(required)"),
        ]
    ]
    copy: Annotated[bool, RARE] = False
    """Copy the files of SRC instead of linking to them."""
    unpack: bool = False
    """Write the video frames as JPEG images, which allow faster random access than videos."""
    offset: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="CAM=FRAMES", help=OFFSET_HELP, help_behavior_hint="(repeatable)"),
    ] = field(default=())
    sync: Annotated[bool, RARE] = False
    """Estimate the videos' time offsets and print them, but do not apply them. If the estimate uses motion, a plot is
    written to OUT/.fourd/sync.png."""
    apply_sync: bool = False
    """Estimate the videos' time offsets, and apply those with a confidence of at least 0.5. Offsets that are estimated
    from motion are applied only if one of them exceeds 3 frames. Offsets of --offset replace estimated ones."""
    sync_by: Annotated[
        SyncMethod,
        RARE,
        describe(
            "Source of estimated time offsets: the soundtracks, or the motion in the images.",
            "auto: sound if all videos have recorded the same sound, otherwise motion.",
        ),
    ] = "auto"
    sound_at: Annotated[str, RARE, tyro.conf.arg(metavar="auto|none|centre|X,Y,Z", help=SOUND_HELP)] = "auto"
    fps: FramesPerSecond = None
    pair_by: Annotated[
        PairBy,
        RARE,
        describe(
            "How images of different cameras are paired.",
            "name: by the frame names or numbers in the file names; frames that a camera lacks are left out. order: "
            "first with first, second with second. auto: name, but refused if the names leave doubt.",
        ),
    ] = "auto"
    resize: Annotated[
        str,
        RARE,
        tyro.conf.arg(
            metavar="MODE",
            help="How images were resized after calibration: auto (detected), scaled, stretched, letterboxed, filled, "
            'or "cropped SIDE" with SIDE left, right, top, bottom or centre.',
        ),
    ] = "auto"
    centres: Annotated[
        PrincipalPointMode,
        RARE,
        describe(
            "How to treat principal points that another program may have mirrored when it rotated the calibration.",
            "auto: warn if principal points seem to be mirrored. as-given: do not check the principal points.",
            "mirrored: correct mirrored principal points.",
        ),
    ] = "auto"
    calibration: Annotated[Path | None, READS, option("FOLDER", "none", CALIBRATION_HELP)] = None
    calibrate: bool = False
    """Calibrate the cameras from the images, and ignore any calibration in SRC."""
    calibrated_frames: Annotated[
        CalibratedFrames,
        RARE,
        describe(
            "Which frames the calibration belongs to, if a video has rotation metadata. "
            "turned: frames that are turned upright. stored: frames as they are stored in the file.",
            "auto: stored if only the stored frames have the orientation of the calibration, otherwise turned.",
        ),
    ] = "auto"
    scale: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="CAM,CAM=METRES|FACTOR", help=SCALE_HELP, help_behavior_hint="(repeatable)"),
    ] = field(default=())
    sound: Annotated[str, option("auto|none|CAM|FILE", "auto", SOUNDTRACK_HELP)] = "auto"
    board: Annotated[str | None, RARE, option("COLSxROWSxSQUARE_M", "none", BOARD_HELP)] = None


def run(arguments: Arguments) -> None:
    """Import the source and print notes and warnings."""
    from fourd.recording.importing.detection import pick_format
    from fourd.recording.importing.given_calibration import VIDEOS_FORMAT
    from fourd.recording.importing.importer import import_source

    if len(arguments.words) not in (2, 3):
        raise UserError(f"expected [FORMAT] SRC OUT, got {len(arguments.words)} arguments; see fourd import --help")
    *name, source, out = arguments.words
    for word in (source, out):
        local_path(word, "import a capture")
    given = () if arguments.calibration is None else (arguments.calibration,)
    require_distinct(Path(out), [Path(source), *given])
    console = Terminal(stderr=True)

    def log(line: str) -> None:
        console.print(Text(line), soft_wrap=True)

    def warn(line: str) -> None:
        console.print(Text("warning: ", "yellow").append(line, "default"), soft_wrap=True)

    check_rate(arguments.fps)
    options = _options(arguments)
    default = None if arguments.calibration is None else VIDEOS_FORMAT
    picked = pick_format(name[0] if name else default, Path(source))
    log(f"{picked.name}: {picked.summary}")
    with locked_folder(Path(out)):
        track = Tracker(console).track
        import_source(picked, Path(source), Path(out), options, log=log, warn=warn, track=track, sound=arguments.sound)
    Terminal().print(
        Text("Imported", "green"), f"next: {command_line('fourd', 'check', Path(out))}", sep="; ", soft_wrap=True
    )


def _options(arguments: Arguments) -> ImportOptions:
    from fourd.recording.importing.importer import ImportOptions

    distance, reduce = _scale(arguments.scale)
    return ImportOptions(
        copy=arguments.copy,
        unpack=arguments.unpack,
        offsets=parse_offsets(arguments.offset),
        sync=arguments.sync,
        apply_sync=arguments.apply_sync,
        sync_by=arguments.sync_by,
        sound_at=_sound_position(arguments.sound_at),
        fps=arguments.fps,
        resize=arguments.resize,
        centres=arguments.centres,
        calibrate=arguments.calibrate,
        calibration=None if arguments.calibration is None else str(resolved(arguments.calibration)),
        reduce=reduce,
        calibrated_frames=arguments.calibrated_frames,
        pair_by=arguments.pair_by,
        distance=distance,
        board=None if arguments.board is None else _board(arguments.board),
    )


def _sound_position(text: str) -> SoundPosition:
    named: dict[str, SoundPosition] = {"auto": "auto", "none": "none", "centre": "centre"}
    if text in named:
        return named[text]
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise UserError(
            f"--sound-at: expected auto, none, centre or X,Y,Z in metres, got '{text}'; write it as 0,0,1.2"
        )
    return x, y, z


def _scale(words: Sequence[str]) -> tuple[Distance | None, float]:
    """Parse the values of --scale: at most one known distance between two cameras, and at most one factor that
    multiplies the width and height of video frames. Returns the distance, or None, and the factor, which is 1 by
    default."""
    distances = [_distance(word) for word in words if "=" in word or "," in word]
    factors = [word for word in words if "=" not in word and "," not in word]
    if len(distances) > 1 or len(factors) > 1:
        raise UserError(
            f"--scale: expected at most one distance and one factor, got {' '.join(words)}; give one of each"
        )
    try:
        factor = float(factors[0]) if factors else 1.0
    except ValueError:
        factor = 0.0
    if not 0 < factor <= 1:
        raise UserError(
            f"--scale: expected CAM,CAM=METRES or a factor above 0 and at most 1, got '{factors[0]}'; write it as "
            "cam01,cam02=2.35 or 0.5"
        )
    return distances[0] if distances else None, factor


def _distance(text: str) -> Distance:
    from fourd.recording.calibration.scale import Distance

    pair, _, metres = text.rpartition("=")
    names = [name.strip() for name in pair.split(",")]
    try:
        value = float(metres)
    except ValueError:
        value = 0.0
    if len(names) != 2 or not all(names) or not (math.isfinite(value) and value > 0):
        raise UserError(f"--scale: expected CAM,CAM=METRES, got '{text}'; write it as cam01,cam02=2.35")
    return Distance(names[0], names[1], value)


def _board(text: str) -> Board:
    from fourd.recording.boards import side_problem
    from fourd.recording.calibration.chessboard import Board

    parts = text.lower().split("x")
    try:
        columns, rows, square = int(parts[0]), int(parts[1]), float(parts[2])
    except (ValueError, IndexError):
        columns, rows, square = 0, 0, 0.0
    if len(parts) != 3 or min(columns, rows) < 3 or not (math.isfinite(square) and square > 0):
        raise UserError(f"--board: expected COLSxROWSxSQUARE_M, got '{text}'; write it as 9x6x0.025")
    problem = side_problem(square)
    if problem is not None:
        raise UserError(f"--board {text}: {problem}")
    return Board(columns, rows, square)
