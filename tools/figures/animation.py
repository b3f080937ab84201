"""Writing of looping animations (WebP) for pages that show no videos, such as README.md on GitHub."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from PIL import Image

from fourd.base.files import atomic_path


def write_animation(path: Path, images: Iterable[Image.Image], seconds: float, quality: int) -> None:
    """Write images as a loop that shows each of them for ``seconds``, and print the number of images and the size."""
    first, *others = images
    with atomic_path(path) as temporary:
        first.save(
            temporary,
            format="WEBP",
            save_all=True,
            append_images=others,
            duration=round(1000 * seconds),
            loop=0,
            quality=quality,
            method=6,
            kmax=1,  # Only whole images. Changed parts would be rectangles that differ from the rest in tone.
        )
    print(f"{path}: {1 + len(others)} images, {path.stat().st_size / 1e6:.2f} MB")
