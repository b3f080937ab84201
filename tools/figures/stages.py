"""Draw one frame after each stage of `fourd make`, and the scene along an orbit, for docs/guides/phones.md.

python tools/figures/stages.py WORK/capture scene.4dv WORK/run/hull docs/figures/guide
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.formats.ply import read_ply
from fourd.recording.capture import open_capture
from fourd.scene.rendering import Scene, open_scene
from fourd.viewer.navigation.paths import orbit

Picture = NDArray[np.uint8]

AZIMUTHS = 6
GREY = 235
POINT_PX = 2
MARGIN_PX = 60


@dataclass(frozen=True)
class Arguments:
    """Inputs and output of the figures."""

    capture: tyro.conf.Positional[Path]
    """Capture with mattes."""
    scene: tyro.conf.Positional[Path]
    """Exported scene."""
    hull: tyro.conf.Positional[Path]
    """Folder with one PLY file per frame. Each file contains the points of the frame's visual hull."""
    out: tyro.conf.Positional[Path]
    """Folder for stages.jpg and orbit.jpg."""
    view: int = 0
    """Index of the camera from which stages.jpg is drawn."""
    frame: int = 4
    """Index, in the scene, of the frame to show."""
    stride: int = 10
    """Every ``stride``-th frame of the capture is a frame of the scene."""
    height: int = 360
    """Height of a panel in pixels."""


def main() -> None:
    """Write both figures."""
    arguments = tyro.cli(Arguments, description=__doc__)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with open_scene(arguments.scene) as scene:
        _write(arguments.out / "stages.jpg", _stages(arguments, scene), arguments.height)
        capture = open_capture(arguments.capture, mattes=False)
        size = (capture.cameras[arguments.view].width, capture.cameras[arguments.view].height)
        cameras = orbit(capture.cameras, AZIMUTHS + 1, size=size)[:AZIMUTHS]
        views = [_render(scene, camera, arguments.frame) for camera in cameras]
        _write(arguments.out / "orbit.jpg", views, arguments.height)


def _stages(arguments: Arguments, scene: Scene) -> list[Picture]:
    """Return the image, the cut-out subject, the points of the hull, and the rendered scene, each (H, W, 3) RGB."""
    number = arguments.frame * arguments.stride
    capture = open_capture(arguments.capture, frames=f"{number}:{number + 1}")
    camera = capture.cameras[arguments.view]
    image = capture.image(arguments.view, 0)
    matte = np.asarray(capture.mask(arguments.view, 0), np.float32)[..., None] / 255
    cut_out = np.asarray(image * matte + GREY * (1 - matte), np.uint8)
    cloud = read_ply(arguments.hull / f"{number:06d}.ply")
    hull = np.full_like(image, GREY)
    seen = cloud.xyz @ camera.rotation.T + camera.translation
    pixels = seen @ camera.intrinsics.T
    for index in np.argsort(-seen[:, 2]):
        x, y = pixels[index, :2] / pixels[index, 2]
        colour = tuple(int(value) for value in cloud.rgb[index])
        cv2.circle(hull, (round(float(x)), round(float(y))), POINT_PX, colour, -1, cv2.LINE_AA)
    return [image, cut_out, hull, _render(scene, camera, arguments.frame)]


def _render(scene: Scene, camera: Camera, frame: int) -> Picture:
    rendered = scene.render(camera, frame)
    blended = rendered.rgb.clip(0, 1) * 255 + GREY * (1 - rendered.alpha[..., None])
    return np.asarray(blended.clip(0, 255), np.uint8)


def _write(path: Path, pictures: Sequence[Picture], height: int) -> None:
    """Write images (H, W, 3) RGB side by side, cropped to the pixel rows that show the subject."""
    # The first image does not define the crop, because in stages.jpg it shows the whole room.
    rows = np.flatnonzero(np.any([(each != GREY).any(axis=(1, 2)) for each in pictures[1:]], axis=0))
    top, bottom = max(rows[0] - MARGIN_PX, 0), rows[-1] + MARGIN_PX
    pictures = [each[top:bottom] for each in pictures]
    scaled = [
        cv2.resize(each, (round(each.shape[1] * height / each.shape[0]), height), interpolation=cv2.INTER_AREA)
        for each in pictures
    ]
    row = np.concatenate(scaled, axis=1)
    cv2.imwrite(str(path), cv2.cvtColor(row, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main()
