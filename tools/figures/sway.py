"""Make a looping animation (WebP) of a capture's images beside its scene, whose view sways around their camera.

The animation of the real recording in README.md is made with:

    python tools/figures/sway.py scene.work/repaired scene.4dv docs/figures/balance.webp --views cam02 cam03 \
        --degrees 12

The scene plays forwards and backwards once for each camera, while the view turns around the subject, to both sides of
the camera and back.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from fourd.base.cameras import Camera, estimate_up
from fourd.recording.capture import open_capture
from fourd.scene import open_scene
from fourd.scene.player import Player
from tools.figures.animation import write_animation

BACKGROUND = (0x14 / 255, 0x17 / 255, 0x1C / 255)
MARGIN = 0.12
"""Width of the border around the subject, as a fraction of the height of its box."""


@dataclass(frozen=True)
class Arguments:
    """Options of the animation."""

    capture: tyro.conf.Positional[Path]
    """The capture of the scene."""
    scene: tyro.conf.Positional[Path]
    """The .4dv file."""
    out: tyro.conf.Positional[Path]
    """The .webp file to write."""
    views: tuple[str, ...]
    """Names of the cameras, in the order of the animation."""
    degrees: float = 20.0
    """Largest angle between the view and the camera."""
    size: tuple[int, int] = (280, 420)
    """Width and height of each of the two images."""
    fps: float = 15.0
    """Images per second."""
    quality: int = 54
    """Quality of the WebP images, 0 to 100."""


def turned(camera: Camera, focus: NDArray[np.float64], up: NDArray[np.float64], degrees: float) -> Camera:
    """Turn a camera around the vertical axis through ``focus``."""
    turn = Rotation.from_rotvec(up * math.radians(degrees)).as_matrix().T
    translation = camera.rotation @ (focus - turn @ focus) + camera.translation
    return replace(camera, rotation=camera.rotation @ turn, translation=translation)


def box_of(alphas: list[NDArray[np.uint8]], size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return the part (left, top, width, height) of images that shows the subject, with the proportions of ``size``."""
    rows, columns = np.nonzero(np.max(alphas, axis=0) > 127)
    height = (rows.max() - rows.min()) * (1 + 2 * MARGIN)
    height = max(height, (columns.max() - columns.min()) * (1 + 2 * MARGIN) * size[1] / size[0])
    width = height * size[0] / size[1]
    left, top = (columns.min() + columns.max() - width) / 2, (rows.min() + rows.max() - height) / 2
    return round(left), round(top), round(width), round(height)


def images(arguments: Arguments) -> Iterator[Image.Image]:
    """Yield the images of the animation."""
    player = Player()
    with open_scene(arguments.scene) as scene, open_capture(arguments.capture, mattes=False) as capture:
        manifest = scene.manifest
        focus, up = np.array(manifest.focus), estimate_up(manifest.cameras)
        frames = [scene.frame(index) for index in range(manifest.frame_count)]
        order = [*range(len(frames)), *range(len(frames) - 2, 0, -1)]
        for view in arguments.views:
            number = capture.names.index(view)
            camera = capture.cameras[number]
            small = camera.rescale(0.25)
            alphas = [player.draw(frame, small, manifest)[..., 3].copy() for frame in frames]
            left, top, width, height = (4 * value for value in box_of(alphas, arguments.size))
            for step, index in enumerate(order):
                angle = arguments.degrees * math.sin(2 * math.pi * step / len(order))
                # Twice the size, because smaller images of the points are smoother.
                shown = turned(camera, focus, up, angle).crop(left, top, width, height)
                shown = shown.resize(2 * arguments.size[0], 2 * arguments.size[1])
                drawn = player.draw(frames[index], shown, manifest, background=BACKGROUND)[..., :3]
                pixels = capture.image(number, manifest.frame_numbers[index])
                recorded = Image.fromarray(pixels).crop((left, top, left + width, top + height))
                yield side_by_side([recorded, Image.fromarray(drawn)], arguments.size)


def side_by_side(parts: list[Image.Image], size: tuple[int, int]) -> Image.Image:
    """Join images, each resized to ``size``."""
    joined = Image.new("RGB", (size[0] * len(parts), size[1]))
    for number, part in enumerate(parts):
        joined.paste(part.resize(size, Image.Resampling.LANCZOS), (size[0] * number, 0))
    return joined


def main() -> None:
    """Draw and write the animation."""
    arguments = tyro.cli(Arguments, description=__doc__)
    write_animation(arguments.out, images(arguments), 1 / arguments.fps, arguments.quality)


if __name__ == "__main__":
    main()
