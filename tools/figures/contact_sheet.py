"""Draw scenes in all preset styles. The results are a contact sheet with one row per scene, and a video in which the
style changes.

    python tools/figures/contact_sheet.py SHEET.jpg --scenes fox.4dv:03 full.4dv:09 --video styles.mp4

Pass each scene as a `.4dv` file, a colon and the name of a camera. In the video, the first scene plays while
the camera circles it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.scene import Scene, open_scene
from fourd.scene.player import Player
from fourd.scene.styled.player import StyledPlayer
from fourd.scene.styles import PRESETS, Style, load_style
from fourd.viewer.navigation.paths import camera_path
from fourd.viewer.output.video import write_video

BACKGROUND = (0.93, 0.93, 0.93)
STEADY_PICTURES = 12
"""Number of images that are drawn from the same camera for each image on the sheet. Only the last one is kept, because
lines fade in over successive images.
"""


@dataclass(frozen=True)
class Arguments:
    """The scenes, and the files to write."""

    sheet: tyro.conf.Positional[Path]
    """JPEG or PNG file of the contact sheet."""
    scenes: tuple[str, ...]
    """Scenes, each as FILE.4dv:CAMERA."""
    size: tuple[int, int] = (300, 300)
    """Width and height of an image in pixels."""
    video: Path | None = None
    """MP4 file of the video. By default, no video is written."""
    seconds: float = 10.0
    """Duration of the video in seconds."""
    video_size: tuple[int, int] = (480, 360)
    """Width and height of the video in pixels."""


def main(arguments: Arguments) -> None:
    rows = [_row(text, arguments.size) for text in arguments.scenes]
    sheet = cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR)
    with atomic_path(arguments.sheet) as temporary:
        _, content = cv2.imencode(arguments.sheet.suffix, sheet, [cv2.IMWRITE_JPEG_QUALITY, 88])
        temporary.write_bytes(content.tobytes())
    if arguments.video is not None:
        _write_video(arguments)


def _open(text: str) -> tuple[Scene, Camera]:
    path, _, name = text.rpartition(":")
    scene = open_scene(path)
    if name not in scene.manifest.names:
        raise UserError(f"--scenes: expected a camera among {', '.join(scene.manifest.names)}, got '{name}'")
    return scene, scene.manifest.camera(name)


def _row(text: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the images of a scene side by side: without a style, and in each preset style."""
    scene, camera = _open(text)
    index = len(scene) // 2
    camera = _zoom(scene, index, camera, size)
    images = [_draw(scene, index, camera, None, None)]
    for preset in PRESETS:
        player = StyledPlayer()
        for _ in range(STEADY_PICTURES):
            image = _draw(scene, index, camera, load_style(preset), player)
        images.append(image)
    return np.hstack(images)


def _zoom(scene: Scene, index: int, camera: Camera, size: tuple[int, int]) -> Camera:
    """Return a camera for an image of ``size``, such that the subject fills the image."""
    alpha = Player().draw(scene.frame(index), camera, scene.manifest)[..., 3]
    left, top, width, height = cv2.boundingRect((alpha > 8).astype(np.uint8))
    side = 1.1 * max(width / size[0], height / size[1], 1e-3)
    wide, high = round(side * size[0]), round(side * size[1])
    cropped = camera.crop(left + (width - wide) // 2, top + (height - high) // 2, wide, high)
    return cropped.resize(*size)


def _draw(
    scene: Scene, index: int, camera: Camera, style: Style | None, player: StyledPlayer | None
) -> NDArray[np.uint8]:
    if style is None or player is None:
        return Player().draw(scene.frame(index), camera, scene.manifest, background=BACKGROUND)[..., :3]
    return player.draw(scene.frame(index), camera, scene.manifest, style, background=BACKGROUND)[..., :3].copy()


def _write_video(arguments: Arguments) -> None:
    scene, _ = _open(arguments.scenes[0])
    assert arguments.video is not None
    fps = 24.0
    steps = round(fps * arguments.seconds)
    cameras = camera_path(
        "orbit", scene.manifest.cameras, np.asarray(scene.manifest.focus), steps, size=arguments.video_size
    )
    styles = [load_style(preset) for preset in PRESETS]
    player = StyledPlayer()

    def images() -> Iterator[NDArray[np.uint8]]:
        for step, camera in enumerate(cameras):
            style = styles[step * len(styles) // steps]
            closer = camera.crop(camera.width // 5, camera.height // 5, 3 * camera.width // 5, 3 * camera.height // 5)
            # The frames are shown forwards and backwards, so that few frames make a continuous motion.
            period = max(1, 2 * len(scene) - 2)
            place = step // 3 % period
            yield _draw(scene, min(place, period - place), closer.resize(*arguments.video_size), style, player)

    write_video(arguments.video, images(), fps, quality=26)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
