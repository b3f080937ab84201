"""The state of the comparison with the captured pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import moderngl

from fourd.viewer.comparison.captured import CapturedPicture, CapturedPictures, find_capture
from fourd.viewer.loaded_scene import LoadedScene

Mode = Literal["off", "side by side", "wipe"]
MODES: tuple[Mode, ...] = ("off", "side by side", "wipe")


@dataclass(frozen=True)
class ShownPicture:
    """The captured picture in the window.

    Attributes:
        camera: index of its camera in the scene's manifest.
        size: (width, height) in pixels.
        texture: OpenGL name of the texture that contains it, with row 0 at the top.
    """

    camera: int
    size: tuple[int, int]
    texture: int


class Comparison:
    """Shows the captured picture of a camera beside the scene, or on the left of a line that the user moves.

    Attributes:
        mode: how the captured picture is shown.
        share: position of the line, from 0 at the left edge of the free area to 1 at its right edge.
        folder: the folder of the capture, which the user may have chosen; None until it is chosen or found.
    """

    def __init__(self, context: moderngl.Context, folder: Path | None = None) -> None:
        self.mode: Mode = "off"
        self.share = 0.5
        self.folder = folder
        self._context = context
        self._pictures: CapturedPictures | None = None
        self._texture: moderngl.Texture | None = None
        self._uploaded: CapturedPicture | None = None

    @property
    def is_on(self) -> bool:
        """Whether a captured picture is shown."""
        return self.mode != "off"

    @property
    def is_reading(self) -> bool:
        """Whether a captured picture is being read. Playback waits for it, because frames of different times cannot be
        compared."""
        return self.is_on and self._pictures is not None and self._pictures.is_reading

    def choose(self, mode: Mode, scene: LoadedScene) -> str:
        """Set the mode. Returns the reason why there is nothing to compare with, or an empty string."""
        if mode == "off":
            self.mode = mode
            return ""
        if not scene.manifest.cameras:
            return f"{scene.path.name}: expected cameras to compare with, got none"
        self.folder = self.folder or find_capture(scene.path)
        if self.folder is None:
            return (
                f"{scene.path.name}: expected its captured pictures, got none; drop the folder of the capture on the "
                "window, or start with --capture FOLDER"
            )
        if self._pictures is None:
            self._pictures = CapturedPictures(self.folder, scene.manifest)
        self.mode = mode
        return ""

    def picture(self, camera: int, frame: int) -> ShownPicture | None:
        """Return the captured picture of a camera and a frame, or an earlier one of this camera while it is read."""
        found = None if self._pictures is None else self._pictures.get(camera, frame)
        if found is None or found.camera != camera:
            return None
        if found is not self._uploaded:
            self._upload(found)
        assert self._texture is not None
        return ShownPicture(camera, self._texture.size, self._texture.glo)

    def take_error(self) -> str:
        """Return the reason why the picture cannot be read, once."""
        return "" if self._pictures is None else self._pictures.take_error()

    def set_folder(self, folder: Path | None) -> None:
        """Compare with the capture in ``folder`` from now on. None looks for the capture of the scene."""
        self.release()
        self.folder = folder

    def release(self) -> None:
        """Switch the comparison off, stop reading and free the texture."""
        self.mode = "off"
        if self._pictures is not None:
            self._pictures.close()
        if self._texture is not None:
            self._texture.release()
        self._pictures = self._texture = self._uploaded = None

    def _upload(self, picture: CapturedPicture) -> None:
        height, width = picture.pixels.shape[:2]
        if self._texture is None or self._texture.size != (width, height):
            if self._texture is not None:
                self._texture.release()
            self._texture = self._context.texture((width, height), 3, alignment=1)
            self._texture.repeat_x = self._texture.repeat_y = False
        self._texture.write(picture.pixels.tobytes(), alignment=1)
        # Captured pictures are often larger than the window. Without smaller copies, they would flicker.
        self._texture.build_mipmaps()
        self._texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        self._uploaded = picture
