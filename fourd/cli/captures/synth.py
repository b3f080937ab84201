"""Make a synthetic capture with ground truth: a textured figure runs and leaps inside a ring of cameras."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from fourd.capture.frame_rate import DEFAULT_FPS
from fourd.errors import UserError
from fourd.synth import SynthSettings, is_finished, make_synthetic


@dataclass(frozen=True)
class Arguments:
    """Two runs with the same options write byte-identical captures."""

    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """Capture folder to write: a new or empty folder, or a synthetic capture, which is replaced."""
    frames: Annotated[str, tyro.conf.arg(metavar="0:N|N")] = "0:24"
    """Number N of frames. The figure's motion repeats after N frames."""
    cameras: int = 12
    """Number of cameras on the ring, 3 to 100."""
    size: int = 256
    """Width and height of the images in pixels, 32 to 4096."""
    seed: int = 0
    """Random seed of the figure's clothes, proportions and gait phase, at least 0."""
    gloss: float = 0.3
    """Strength of the specular highlights, 0 to 1."""
    fps: float = DEFAULT_FPS
    """Frame rate of the capture in frames per second."""


def run(arguments: Arguments) -> None:
    """Make the capture, unless a finished capture with the same options exists."""
    settings = SynthSettings(
        _frame_count(arguments.frames),
        arguments.cameras,
        arguments.size,
        arguments.seed,
        arguments.gloss,
        arguments.fps,
    )
    console = Console(stderr=True)
    if is_finished(arguments.out, settings):
        console.print(f"{arguments.out}: already finished with these settings", soft_wrap=True)
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


def _frame_count(frames: str) -> int:
    """Parse the number N of frames from ``0:N`` or ``N``."""
    first, _, last = frames.rpartition(":")
    if first.strip() not in ("", "0") or not last.strip().isdecimal():
        raise UserError(f"--frames: expected 0:N or N for N frames, got '{frames}'; write for example 0:24")
    return int(last)
