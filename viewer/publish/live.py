"""Writes scenes for browsers, and writes a scene again whenever its source changes. The source is a `.4dv` file, which
the user may export again, or a run, which may be training."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.progress import Track, Tracker
from fourd.reconstruction.training.run_layout import newest_checkpoint, segment_folders
from fourd.scene.files.encoding import Tier
from fourd.scene.styles import Style
from fourd.viewer.publish.site import POSTER_NAME, SCENE_NAME, copy_player, write_poster, write_scene

_POLL_SECONDS = 2.0


Item = TypeVar("Item")


@dataclass(frozen=True)
class WritingProgress:
    """How far the writing of a scene is.

    Attributes:
        work: what is being done, such as "export" or "pack".
        done: number of finished frames.
        count: number of all frames.
    """

    work: str
    done: int
    count: int


class LiveScene:
    """Writes a source as a scene for browsers, and writes it again when the source changes.

    Args:
        source: a `.4dv` file or a run.
        folder: the folder to which the scene and its poster are written. It must not exist.
        tier: tier (quality, such as "stream") in which a scene is packed, if it is not packed yet.
        console: prints progress and errors of updates.

    Attributes:
        version: identifies the version of the source that was written last, or an empty string.
        error: the reason why the newest version could not be written, or an empty string.
        progress: how far the writing is, or None while nothing is written.
    """

    def __init__(self, source: Path, folder: Path, tier: Tier, console: Console) -> None:
        self.version = ""
        self.error = ""
        self.progress: WritingProgress | None = None
        self._source = source
        self._folder = folder
        self._tier = tier
        self._console = console
        self._tried = ""
        folder.mkdir(parents=True)

    def has_news(self) -> bool:
        """Return True if the source has a version that :meth:`update` has not tried to write."""
        return self._read_version() not in (self._tried, "")

    def write(self) -> None:
        """Write the current version of the source. Raises UserError or OSError."""
        self._tried = self._read_version()
        try:
            self._write()
        finally:
            self.progress = None
        self.version, self.error = self._tried, ""

    def update(self) -> bool:
        """Write the scene again if the source has changed. Returns True if the scene was written.

        After an error, the last scene is kept. The error is printed once per version of the source.
        """
        if not self.has_news():
            return False
        before = self._tried
        try:
            self.write()
        except FileNotFoundError:
            self._tried = before
            return False  # Training has just replaced the checkpoint. The next call reads the new one.
        except (UserError, OSError) as error:
            self.error = str(error)
            self._console.print(f"{self._source}: not updated: {error}", soft_wrap=True, markup=False)
            return False
        return True

    def _read_version(self) -> str:
        """Return a string that identifies the current version of the source. It is empty if the source is temporarily
        missing."""
        with suppress(OSError):
            if self._source.is_dir():
                parts = segment_folders(self._source) or [self._source]
                return " ".join(filter(None, (newest_checkpoint(part) for part in parts)))
            status = self._source.stat()
            return f"{status.st_mtime_ns} {status.st_size} {status.st_ino}"
        return ""

    def _write(self) -> None:
        with tempfile.TemporaryDirectory(dir=self._folder.parent) as temporary:
            scene = self._source
            if scene.is_dir():
                scene = Path(temporary) / "baked.4dv"
                bake_to(self._source, scene, self._console, self._track)
            written = Path(temporary) / SCENE_NAME
            write_scene(scene, written, self._tier, self._track)
            write_poster(written, Path(temporary) / POSTER_NAME)
            for name in (POSTER_NAME, SCENE_NAME):
                (Path(temporary) / name).replace(self._folder / name)

    def _track(self, items: Iterable[Item], count: int, what: str) -> Iterator[Item]:
        """Yield the items, print the progress and keep it for :attr:`progress`."""
        for done, item in enumerate(Tracker(self._console).track(items, count, what)):
            self.progress = WritingProgress(what, done, count)
            yield item


class LiveSite:
    """Writes a web page that plays a source, and writes the page's scene again when the source changes.

    Args:
        source: a `.4dv` file or a run.
        folder: the folder to write. It must not exist.
        tier: tier (quality, such as "stream") in which a scene is packed, if it is not packed yet.
        console: prints progress and errors of updates.
        styles: the styles that the page offers, by name. If None, the page offers the presets.

    Raises:
        UserError: if the source is neither a scene nor a run with a checkpoint.
    """

    def __init__(
        self,
        source: Path,
        folder: Path,
        tier: Tier,
        console: Console,
        styles: Mapping[str, Style] | None = None,
    ) -> None:
        self._stopped = threading.Event()
        self._scene = LiveScene(source, folder, tier, console)
        self._scene.write()
        copy_player(folder, source.stem, is_live=True, styles=styles)

    def update(self) -> bool:
        """Write the scene again if the source has changed, as :meth:`LiveScene.update` does."""
        return self._scene.update()

    def watch(self) -> None:
        """Call :meth:`update` every two seconds until :meth:`stop`."""
        while not self._stopped.wait(_POLL_SECONDS):
            self.update()

    def stop(self) -> None:
        """Make :meth:`watch` return."""
        self._stopped.set()


def bake_to(run: Path, scene: Path, console: Console, track: Track) -> None:
    """Write the newest checkpoint of a run as the scene file ``scene``. Raises UserError."""
    # Only runs need torch.
    from fourd.reconstruction.training.segments.segmented_run import open_trained
    from fourd.scene.bake import bake_run

    bake_run(open_trained(run), scene, console, track=track)
