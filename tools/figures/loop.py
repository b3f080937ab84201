"""Make a looping animation (WebP) from parts of a video, for pages that show no videos, such as README.md on GitHub.

The animation of the generated recording in README.md is made with:

    python tools/figures/loop.py docs/figures/styles.mp4 docs/figures/turning.webp --frames 0:240:2
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import av
import tyro
from PIL import Image

from tools.figures.animation import write_animation


@dataclass(frozen=True)
class Arguments:
    """Options of the animation."""

    video: tyro.conf.Positional[Path]
    """The video."""
    out: tyro.conf.Positional[Path]
    """The .webp file to write."""
    frames: tuple[str, ...] = ("0:",)
    """Parts of the video to show one after the other, each as FIRST:END or FIRST:END:STEP. END is not included."""
    width: int = 480
    """Width of the animation in pixels."""
    quality: int = 55
    """Quality of the WebP images, 0 to 100."""


def main() -> None:
    """Decode the video and write the animation."""
    arguments = tyro.cli(Arguments, description=__doc__)
    with av.open(str(arguments.video)) as container:
        rate = float(container.streams.video[0].average_rate or 25)
        images = [frame.to_image() for frame in container.decode(video=0)]
    parts = [_slice(text) for text in arguments.frames]
    shown = (_resized(image, arguments.width) for part in parts for image in images[part])
    write_animation(arguments.out, shown, (parts[0].step or 1) / rate, arguments.quality)


def _slice(text: str) -> slice:
    """Convert FIRST:END or FIRST:END:STEP to a slice."""
    return slice(*(int(part) if part else None for part in text.split(":")))


def _resized(image: Image.Image, width: int) -> Image.Image:
    return image.resize((width, round(width * image.height / image.width)), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main()
