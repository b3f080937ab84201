"""Make docs/figures/demo.png from the folder demo/ that ``make demo`` has written.

The figure shows an image of a held-out camera, the scene rendered from this camera, and the scene rendered from three
viewpoints between the cameras.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from fourd.baking.container import SceneReader
from fourd.baking.player import Player
from fourd.cameras import Camera
from fourd.capture.reader import Capture, open_capture
from fourd.files import atomic_path
from fourd.viewer.navigation.paths import orbit

BACKGROUND = 244
TEXT_COLOUR = (60, 60, 60)
FRAMES = (2, 6, 10)
AZIMUTHS = (0.09, 0.41, 0.72)
"""Azimuths of the novel views, as fractions of a full circle. The azimuth of the first camera is 0."""

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Arguments:
    """Inputs and output of the figure."""

    demo: Path = Path("demo")
    """Folder that `make demo` has written."""
    out: Path = Path("docs/figures/demo.png")
    """PNG file to write."""
    camera: str = "03"
    """Name of a camera that `make demo` holds out."""
    width: int = 240
    """Width of a panel in pixels."""


def main() -> None:
    """Draw the panels side by side and write the PNG file."""
    arguments = tyro.cli(Arguments, description=__doc__)
    capture = open_capture(arguments.demo / "capture")
    index = capture.names.index(arguments.camera)
    reader = SceneReader(arguments.demo / "scene.4dv")
    camera = capture.cameras[index]
    panels = [
        ("photograph, held out", cut_out(capture, index, 0)),
        ("fourd, same view", draw(reader, 0, camera)),
    ]
    around = orbit(capture.cameras, 100, size=(camera.width, camera.height))
    for frame, azimuth in zip(FRAMES, AZIMUTHS, strict=True):
        panels.append((f"new view, frame {frame}", draw(reader, frame, around[round(100 * azimuth)])))
    picture = np.hstack([with_label(label, panel, arguments.width) for label, panel in panels])
    with atomic_path(arguments.out) as path:
        path.write_bytes(cv2.imencode(".png", picture[..., ::-1])[1].tobytes())


def cut_out(capture: Capture, camera: int, frame: int) -> Picture:
    """Return a camera image (H, W, 3) in which the background colour replaces everything except the subject."""
    matte = capture.mask(camera, frame)[..., None] / 255
    return np.rint(capture.image(camera, frame) * matte + BACKGROUND * (1 - matte)).astype(np.uint8)


def draw(reader: SceneReader, frame: int, camera: Camera) -> Picture:
    """Render the scene over the background colour. Return the image (H, W, 3)."""
    grey = BACKGROUND / 255
    return Player().draw(reader.read(frame), camera, reader.manifest, background=(grey, grey, grey))[..., :3]


def with_label(label: str, picture: Picture, width: int) -> Picture:
    """Return a panel of the given width that shows the middle of ``picture``, with a label above it."""
    middle = picture.shape[1] // 2
    left = max(0, min(middle - width // 2, picture.shape[1] - width))
    panel = np.full((picture.shape[0] + 40, width, 3), BACKGROUND, np.uint8)
    panel[40:] = picture[:, left : left + width]
    cv2.putText(panel, label, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.45, TEXT_COLOUR, 1, cv2.LINE_AA)
    return panel


if __name__ == "__main__":
    main()
