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

from fourd.base.files import atomic_path


@dataclass(frozen=True)
class Arguments:
    """Options of the animation."""

    video: tyro.conf.Positional[Path]
    """The video."""
    out: tyro.conf.Positional[Path]
    """The .webp file to write."""
    frames: tuple[str, ...] = ("0:",)
    """Parts of the video to show one after the other, each as FIRST:END or FIRST:END:STEP. END is not included."""
    columns: tuple[str, ...] = ()
    """Columns of pixels to show side by side, each as FIRST:END. All columns by default."""
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
    shown = [_columns(image, arguments.columns, arguments.width) for part in parts for image in images[part]]
    seconds = (parts[0].step or 1) / rate
    with atomic_path(arguments.out) as temporary:
        shown[0].save(
            temporary,
            format="WEBP",
            save_all=True,
            append_images=shown[1:],
            duration=round(1000 * seconds),
            loop=0,
            quality=arguments.quality,
            method=6,
            kmax=1,  # Only whole images. Changed parts would be rectangles that differ from the rest in tone.
        )
    print(f"{arguments.out}: {len(shown)} images, {arguments.out.stat().st_size / 1e6:.2f} MB")


def _slice(text: str) -> slice:
    """Convert FIRST:END or FIRST:END:STEP to a slice."""
    return slice(*(int(part) if part else None for part in text.split(":")))


def _columns(image: Image.Image, columns: tuple[str, ...], width: int) -> Image.Image:
    """Cut columns out of an image, put them side by side and resize the result to ``width``."""
    cuts = [range(image.width)[_slice(text)] for text in columns] or [range(image.width)]
    joined = Image.new("RGB", (sum(len(cut) for cut in cuts), image.height))
    left = 0
    for cut in cuts:
        joined.paste(image.crop((cut[0], 0, cut[-1] + 1, image.height)), (left, 0))
        left += len(cut)
    return joined.resize((width, round(width * joined.height / joined.width)), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main()
