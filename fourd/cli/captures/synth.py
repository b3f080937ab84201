"""Make a synthetic capture with ground truth: a textured figure runs and leaps inside a ring of cameras, or two people
stand and walk in a dome. With --rig, record a clean capture as a real rig would."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from fourd.base.errors import UserError
from fourd.base.processes import locked_folder
from fourd.base.progress import Terminal, Tracker
from fourd.cli.options import option
from fourd.cli.outputs import READS, WRITES
from fourd.recording.capture.frame_rate import DEFAULT_FPS
from fourd.recording.synth.rig import FACTORS, USUAL
from fourd.recording.synth.rig.settings import Codec

if TYPE_CHECKING:
    from fourd.recording.synth import SynthSettings
    from fourd.recording.synth.board_videos import BoardSettings
    from fourd.recording.synth.dome import DomeSettings

FRAMES_HELP = "Number N of frames. The figure's motion repeats after N frames."
CAMERAS_HELP = (
    "Number of cameras on the ring or in the dome, 3 to 100. With --board, number of cameras on an arc, 2 to 100."
)
SIZE_HELP = (
    "Width and height of the images in pixels, 32 to 4096. With --board, the minimum is 128. With --dome, the minimum "
    "is 64, and the height is 9/16 of the width."
)
RIG_HELP = (
    "Record the figure, or the capture of --from, as a real rig would. NAME or NAME=VALUE selects a factor; without a "
    "name, all factors are selected. 0 switches a factor off: all,people=0. Names and usual strengths: "
    + ", ".join(f"{name}={getattr(USUAL, name.replace('-', '_')):g}" for name in FACTORS)
    + ". The truth is written to OUT/truth/."
)


@dataclass(frozen=True)
class Arguments:
    """Repeated commands with the same options write byte-identical captures."""

    out: tyro.conf.Positional[Annotated[Path, WRITES, tyro.conf.arg(metavar="OUT")]]
    """Capture folder to write. The folder must be new or empty, or contain a synthetic capture, which is replaced."""
    board: bool = False
    """Instead of a capture, make videos of a moving calibration board for fourd calibrate. The true calibration is
    written to OUT/truth/."""
    dome: bool = False
    """Instead of the ring, make a capture in a dome: the cameras are in the walls and have dark bodies, which the other
    cameras see. One person stands, another one walks past cameras, and they throw a ball. Each camera has its own
    exposure, white balance and noise."""
    frames: Annotated[str | None, option("0:N|N", "0:24, with --board 0:60", FRAMES_HELP)] = None
    cameras: Annotated[int | None, option("INT", "12, with --board 4, with --dome 20", CAMERAS_HELP)] = None
    size: Annotated[int | None, option("INT", "256, with --board 640, with --dome 320", SIZE_HELP)] = None
    seed: int = 0
    """Random seed, at least 0. The seed determines the figure's clothes, proportions and gait phase, or the board's
    motion, or the people and the details of the dome."""
    gloss: float = 0.3
    """Strength of the specular highlights, 0 to 1."""
    fps: float = DEFAULT_FPS
    """Frame rate of the capture in frames per second."""
    masks: bool = True
    """With --dome, --no-masks makes a capture without masks. The true masks are then in OUT/truth/masks/."""
    rig: Annotated[tuple[str, ...] | None, option("[NAME[=VALUE],...]", "none", RIG_HELP)] = None
    from_: Annotated[
        Path | None,
        READS,
        tyro.conf.arg(name="from", metavar="CAPTURE", help_behavior_hint="(default: the figure in the ring)"),
    ] = None
    """With --rig: an existing clean capture to record. It is not changed."""
    codec: Annotated[Codec | None, option("{h264,hevc}", "h264", "With --rig: format of the videos.")] = None
    mbps: Annotated[
        float | None, option("FLOAT", "constant quality", "With --rig: bit rate of each video in Mbit/s.")
    ] = None


def run(arguments: Arguments) -> None:
    """Make the capture, unless a finished capture with the same options exists."""
    with locked_folder(arguments.out):
        _make(arguments)


def _make(arguments: Arguments) -> None:
    if arguments.board and arguments.dome:
        raise UserError("--dome: expected one of --board and --dome, got both; leave out one of them")
    if not arguments.masks and not arguments.dome:
        raise UserError("--no-masks: expected the option --dome, got a capture without it; leave out --no-masks")
    if arguments.rig is None:
        given = [name for name, value in _rig_options(arguments) if value is not None]
        if given:
            raise UserError(f"--{given[0]}: expected the option --rig, got a capture without it; add --rig")
    elif arguments.board or arguments.dome:
        other = "--board" if arguments.board else "--dome"
        raise UserError(f"--rig: expected no {other}, got both; make the other capture first, and name it with --from")
    if arguments.rig is not None:
        _make_rig(arguments, arguments.rig)
    elif arguments.board:
        _make_board(arguments)
    elif arguments.dome:
        _make_dome(arguments)
    else:
        _make_ring(arguments)


def _make_board(arguments: Arguments) -> None:
    from fourd.recording.synth.board_videos import BoardSettings, make_board_videos

    console = Terminal(stderr=True)
    videos = BoardSettings(*_numbers(arguments, BoardSettings(seed=arguments.seed)), arguments.seed)
    make_board_videos(arguments.out, videos, Tracker(console).track)
    line = f"{arguments.out}: {videos.cameras} videos of {videos.frames} frames, {videos.board.describe()}"
    console.print(line, soft_wrap=True, markup=False, highlight=False)


def _make_dome(arguments: Arguments) -> None:
    from fourd.recording.synth.dome import DomeSettings, make_dome, suggested_test_views

    console = Terminal(stderr=True)
    numbers = _numbers(arguments, DomeSettings(seed=arguments.seed))
    settings = DomeSettings(*numbers, arguments.seed, arguments.gloss, arguments.fps, arguments.masks)
    if _needs_making(arguments.out, settings.stored(), console):
        make_dome(arguments.out, settings)
        line = f"{arguments.out}: {settings.cameras} cameras x {settings.frames} frames"
        console.print(line, soft_wrap=True, markup=False)
    views = ",".join(suggested_test_views(settings))
    console.print(f"Cameras with neighbours on all sides: --test-views {views}", soft_wrap=True)


def _make_rig(arguments: Arguments, words: tuple[str, ...]) -> None:
    from fourd.recording.synth import SynthSettings
    from fourd.recording.synth.rig import make_rig_capture, parse_factors
    from fourd.recording.synth.rig.generate import stored_settings

    console = Terminal(stderr=True)
    settings = parse_factors(words, codec=arguments.codec or "h264", mbps=arguments.mbps, seed=arguments.seed)
    clean = arguments.from_ or _ring_settings(arguments)
    if arguments.from_ is not None:
        unused = {"frames": None, "cameras": None, "size": None, "gloss": SynthSettings.gloss, "fps": DEFAULT_FPS}
        for name, default in unused.items():
            if getattr(arguments, name) != default:
                raise UserError(f"--{name}: expected no such option with --from, got one; leave it out")
    if _needs_making(arguments.out, stored_settings(clean, settings), console):
        make_rig_capture(arguments.out, clean, settings)
        console.print(f"{arguments.out}: recorded; the truth is in {arguments.out / 'truth'}", soft_wrap=True)


def _rig_options(arguments: Arguments) -> list[tuple[str, object]]:
    return [("from", arguments.from_), ("codec", arguments.codec), ("mbps", arguments.mbps)]


def _ring_settings(arguments: Arguments) -> SynthSettings:
    from fourd.recording.synth import SynthSettings

    numbers = _numbers(arguments, SynthSettings(seed=arguments.seed))
    return SynthSettings(*numbers, arguments.seed, arguments.gloss, arguments.fps)


def _make_ring(arguments: Arguments) -> None:
    from fourd.recording.synth import make_synthetic

    console = Terminal(stderr=True)
    settings = _ring_settings(arguments)
    if not _needs_making(arguments.out, asdict(settings), console):
        return
    make_synthetic(
        arguments.out,
        frames=settings.frames,
        cameras=settings.cameras,
        size=settings.size,
        seed=settings.seed,
        gloss=settings.gloss,
        fps=settings.fps,
    )
    console.print(f"{arguments.out}: {settings.cameras} cameras x {settings.frames} frames", soft_wrap=True)


def _numbers(arguments: Arguments, defaults: BoardSettings | DomeSettings | SynthSettings) -> tuple[int, int, int]:
    """Return the number of frames, the number of cameras and the size of the images."""
    return (
        defaults.frames if arguments.frames is None else _frame_count(arguments.frames),
        defaults.cameras if arguments.cameras is None else arguments.cameras,
        defaults.size if arguments.size is None else arguments.size,
    )


def _needs_making(out: Path, settings: Mapping[str, object], console: Terminal) -> bool:
    """Return whether the capture does not exist with these settings. The state of an existing one is printed."""
    from fourd.recording.synth.folder import has_finished, read_settings

    if has_finished(out, settings):
        console.print(f"{out}: already finished with these settings", soft_wrap=True)
        return False
    old = read_settings(out)
    if old is not None:
        names = [*settings, *(name for name in old if name not in (*settings, "version", "finished"))]
        changes = [
            f"{name}: {old.get(name)} -> {settings.get(name)}" for name in names if old.get(name) != settings.get(name)
        ]
        reason = ", ".join(changes) or "it was not finished"
        console.print(f"{out}: the synthetic capture is made again ({reason})", soft_wrap=True)
    return True


def _frame_count(frames: str) -> int:
    """Parse the number N of frames from ``0:N`` or ``N``."""
    first, _, last = frames.rpartition(":")
    if first.strip() not in ("", "0") or not last.strip().isdecimal():
        raise UserError(f"--frames: expected 0:N or N for N frames, got '{frames}'; write for example 0:24")
    return int(last)
