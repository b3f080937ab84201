"""Make a synthetic capture with ground truth: a textured figure runs and leaps inside a ring of cameras."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from fourd.capture.frame_rate import DEFAULT_FPS
from fourd.cli.options import option
from fourd.cli.outputs import WRITES
from fourd.errors import UserError
from fourd.processes import locked_folder
from fourd.progress import Terminal, Tracker
from fourd.synth import SynthSettings, is_finished, make_synthetic
from fourd.synth.board_videos import BoardSettings, make_board_videos
from fourd.synth.generate import read_settings

FRAMES_HELP = "Number N of frames. The figure's motion repeats after N frames."
CAMERAS_HELP = "Number of cameras on the ring, 3 to 100. With --board, number of cameras on an arc, 2 to 100."
SIZE_HELP = "Width and height of the images in pixels, 32 to 4096. With --board, the minimum is 128."


@dataclass(frozen=True)
class Arguments:
    """Repeated commands with the same options write byte-identical captures."""

    out: tyro.conf.Positional[Annotated[Path, WRITES, tyro.conf.arg(metavar="OUT")]]
    """Capture folder to write. The folder must be new or empty, or contain a synthetic capture, which is replaced."""
    board: bool = False
    """Instead of a capture, make videos of a moving calibration board for fourd calibrate. The true calibration is
    written to OUT/truth/."""
    frames: Annotated[str | None, option("0:N|N", "0:24, with --board 0:60", FRAMES_HELP)] = None
    cameras: Annotated[int | None, option("INT", "12, with --board 4", CAMERAS_HELP)] = None
    size: Annotated[int | None, option("INT", "256, with --board 640", SIZE_HELP)] = None
    seed: int = 0
    """Random seed, at least 0. The seed determines the figure's clothes, proportions and gait phase, or the board's
    motion."""
    gloss: float = 0.3
    """Strength of the specular highlights, 0 to 1."""
    fps: float = DEFAULT_FPS
    """Frame rate of the capture in frames per second."""


def run(arguments: Arguments) -> None:
    """Make the capture, unless a finished capture with the same options exists."""
    with locked_folder(arguments.out):
        _make(arguments)


def _make(arguments: Arguments) -> None:
    console = Terminal(stderr=True)
    defaults = BoardSettings(seed=arguments.seed) if arguments.board else SynthSettings(seed=arguments.seed)
    frames = defaults.frames if arguments.frames is None else _frame_count(arguments.frames)
    cameras = defaults.cameras if arguments.cameras is None else arguments.cameras
    size = defaults.size if arguments.size is None else arguments.size
    if arguments.board:
        videos = BoardSettings(frames, cameras, size, arguments.seed)
        make_board_videos(arguments.out, videos, Tracker(console).track)
        line = f"{arguments.out}: {videos.cameras} videos of {videos.frames} frames, {videos.board.describe()}"
        console.print(line, soft_wrap=True, markup=False, highlight=False)
        return
    settings = SynthSettings(frames, cameras, size, arguments.seed, arguments.gloss, arguments.fps)
    if is_finished(arguments.out, settings):
        console.print(f"{arguments.out}: already finished with these settings", soft_wrap=True)
        return
    old = read_settings(arguments.out)
    if old is not None:
        new = asdict(settings)
        changes = [f"{name}: {old.get(name)} -> {new[name]}" for name in new if old.get(name) != new[name]]
        reason = ", ".join(changes) or "it was not finished"
        console.print(f"{arguments.out}: the synthetic capture is made again ({reason})", soft_wrap=True)
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


def _frame_count(frames: str) -> int:
    """Parse the number N of frames from ``0:N`` or ``N``."""
    first, _, last = frames.rpartition(":")
    if first.strip() not in ("", "0") or not last.strip().isdecimal():
        raise UserError(f"--frames: expected 0:N or N for N frames, got '{frames}'; write for example 0:24")
    return int(last)
