"""The packed scene file of a widget, of which the page reads ranges, and the picture that is shown without scripts."""

from __future__ import annotations

import io
import tempfile
from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.progress import Terminal, Tracker
from fourd.scene import SceneReader
from fourd.scene.container import frame_folder
from fourd.scene.files.encoding import Tier
from fourd.scene.packed.members import packed_names
from fourd.scene.packed.streams import is_zlib
from fourd.viewer.publish.live import bake_to
from fourd.viewer.publish.site import SCENE_NAME, draw_poster, write_scene

POSTER_SIDE = 640
"""Longest side of the picture in pixels."""
MAX_RANGE = 1 << 22
"""Maximum number of bytes of a range that a page may ask for."""


@dataclass(frozen=True)
class ServedScene:
    """A packed scene in the form that browsers read.

    Attributes:
        name: name of the scene in messages.
        path: the file.
        size: size of the file in bytes.
        modified_ns: time of the file's last change.
        poster: the first frame from the first camera, as a PNG file.
        temporary: the folder of the file, which is removed with the widget. None if the file is the user's own.
    """

    name: str
    path: Path
    size: int
    modified_ns: int
    poster: bytes
    temporary: tempfile.TemporaryDirectory[str] | None

    def read(self, offset: object, size: object) -> bytes:
        """Return a range of bytes, or fewer if the file ends inside the range.

        Raises:
            UserError: if the page asks for no valid range, or the file has changed since the widget was made.
        """
        if not (isinstance(offset, int) and isinstance(size, int) and offset >= 0 and 0 <= size <= MAX_RANGE):
            raise UserError(f"{self.name}: expected a range of at most {MAX_RANGE} bytes, got {offset!r}, {size!r}")
        try:
            status = self.path.stat()
            if (status.st_size, status.st_mtime_ns) != (self.size, self.modified_ns):
                raise UserError(f"{self.name}: expected an unchanged file, got a newer one; call fourd.show again")
            with self.path.open("rb") as stream:
                stream.seek(offset)
                return stream.read(size)
        except OSError as error:
            got = f"got none ({error.strerror or error})"
            raise UserError(f"{self.name}: expected the file of the scene, {got}; call fourd.show again") from error

    def close(self) -> None:
        """Remove the file if it was written for the widget."""
        if self.temporary is not None:
            self.temporary.cleanup()


def serve(source: Path, tier: Tier, console: Terminal) -> ServedScene:
    """Prepare a scene or a run for a widget.

    A scene that browsers can read is used as it is. Any other scene is packed into a temporary file, and a run is baked
    first.

    Raises:
        UserError: if ``source`` is neither a scene nor a run with a checkpoint, or if it has no frames or no cameras.
    """
    if source.is_file() and is_for_browsers(source):
        return _describe(source.name, source, None)
    temporary = tempfile.TemporaryDirectory(prefix="fourd-show-")
    try:
        folder, track = Path(temporary.name), Tracker(console).track
        scene = source
        if source.is_dir():
            scene = folder / "baked.4dv"
            bake_to(source, scene, console, track)
        write_scene(scene, folder / SCENE_NAME, tier, track)
        if scene is not source:
            scene.unlink()
        return _describe(source.name, folder / SCENE_NAME, temporary)
    except BaseException:
        temporary.cleanup()
        raise


def is_for_browsers(path: Path) -> bool:
    """Return True if a scene is packed and compressed with zlib, as `fourd web` writes it. Raises UserError if it is
    not a valid scene."""
    reader = SceneReader(path)
    try:
        manifest = reader.manifest
        if manifest.encoding is None or manifest.frame_count == 0 or not manifest.cameras:
            return False
        return is_zlib(reader.read_member(f"{frame_folder(0)}/{packed_names(manifest)[0]}"))
    finally:
        reader.close()


def _describe(name: str, path: Path, temporary: tempfile.TemporaryDirectory[str] | None) -> ServedScene:
    picture = io.BytesIO()
    draw_poster(path, POSTER_SIDE).save(picture, "PNG", optimize=True)
    status = path.stat()
    return ServedScene(name, path, status.st_size, status.st_mtime_ns, picture.getvalue(), temporary)
