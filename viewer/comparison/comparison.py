"""The state of the comparison with the captured pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import moderngl

from fourd.viewer.comparison.captured import CapturedPicture, CapturedPictures, find_capture
from fourd.viewer.comparison.other_scene import OtherScene
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
    """Shows the captured picture of a camera, or another scene, beside the scene or on the left of a line that the user
    moves.

    Attributes:
        mode: how the captured picture is shown.
        share: position of the line, from 0 at the left edge of the free area to 1 at its right edge.
        folder: the folder of the capture, which the user may have chosen; None until it is chosen or found.
        other: the other scene, or None while captured pictures are compared.
        given_error: the reason why the other scene that was given at the start cannot be opened, or None.
    """

    def __init__(self, context: moderngl.Context, folder: Path | None = None, other: Path | None = None) -> None:
        """``folder`` and ``other`` are the capture and the other scene to compare the first scene with, or None."""
        self.mode: Mode = "off"
        self.share = 0.5
        self.folder: Path | None = None
        self.other: OtherScene | None = None
        self.given_error: Exception | None = None
        self._is_other_given = False
        self._given: tuple[Path | None, Path | None] = folder, other
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
        """Whether a captured picture or a frame of the other scene is being read. Playback waits for it, because frames
        of different times cannot be compared."""
        if not self.is_on:
            return False
        if self.other is not None:
            return self.other.is_busy
        return self._pictures is not None and self._pictures.is_reading

    @property
    def needs_image(self) -> bool:
        """Whether the next image may differ, although the user does nothing."""
        return self.is_reading or (self.is_on and self.other is not None and self.other.is_stale)

    def start(self) -> None:
        """Forget the scene that was compared, because another one is shown. The capture and the other scene that were
        given belong to the first scene."""
        (folder, other), self._given = self._given, (None, None)
        self.set_folder(folder)
        if other is not None:
            self.set_other(other)
            self._is_other_given = True

    def choose(self, mode: Mode, scene: LoadedScene) -> str:
        """Set the mode. Returns the reason why there is nothing to compare with, or an empty string."""
        if mode == "off" or self.other is not None:
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
        """Return the reason why the picture or the other scene cannot be read, once."""
        if self.other is not None:
            error = self.other.take_error()
            if self.other.error is not None:
                self.given_error = self.other.error if self._is_other_given else None
                self.release()
            return error
        return "" if self._pictures is None else self._pictures.take_error()

    def set_folder(self, folder: Path | None) -> None:
        """Compare with the capture in ``folder`` from now on. None looks for the capture of the scene."""
        self.release()
        self.folder = folder

    def set_other(self, path: Path) -> None:
        """Compare with the scene in ``path`` from now on, side by side at first."""
        self.release()
        self._is_other_given = False
        self.other = OtherScene(self._context, path)
        self.mode = "side by side"

    def release(self) -> None:
        """Switch the comparison off, stop reading, and free the texture and the other scene."""
        self.mode = "off"
        if self.other is not None:
            self.other.release()
            self.other = None
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
