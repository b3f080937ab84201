"""Make a synthetic capture with truth: a textured figure that runs and leaps within a ring of cameras."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console

from fourd.synth import SynthSettings, is_finished, make_synthetic


@dataclass(frozen=True)
class Arguments:
    """The same settings give the same bytes."""

    out: tyro.conf.Positional[Path]
    """The capture's folder: new, empty, or a synthetic capture to replace."""
    frames: int = 24
    """Number of frames, at least 1; the movement loops."""
    cameras: int = 12
    """Number of cameras on the ring, 3 to 100."""
    size: int = 256
    """Width and height of the pictures in pixels, 32 to 4096."""
    seed: int = 0
    """Decides the clothes, the proportions and where the gait begins; at least 0."""
    gloss: float = 0.3
    """Strength of the highlights, 0 to 1."""


def run(arguments: Arguments) -> None:
    """Make the capture unless it is there already."""
    settings = SynthSettings(arguments.frames, arguments.cameras, arguments.size, arguments.seed, arguments.gloss)
    console = Console(stderr=True)
    if is_finished(arguments.out, settings):
        console.print(f"{arguments.out}: done already with these settings", soft_wrap=True)
        return
    make_synthetic(
        arguments.out,
        frames=settings.frames,
        cameras=settings.cameras,
        size=settings.size,
        seed=settings.seed,
        gloss=settings.gloss,
    )
    console.print(f"{arguments.out}: {settings.cameras} cameras x {settings.frames} frames", soft_wrap=True)
