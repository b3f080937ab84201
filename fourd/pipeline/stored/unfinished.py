"""Uploads the files of a stage while it is still running, so that another machine can continue from the last upload if
the stage's machine is lost.

The files are published with their own manifest, whose name is the name of the stage followed by ``SUFFIX``.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import PurePosixPath

from fourd.base.errors import UserError
from fourd.base.processes import called_every
from fourd.base.progress import Log, Track
from fourd.pipeline.stored.cache import Cache
from fourd.pipeline.stored.manifest import Manifest
from fourd.pipeline.stored.work_store import WorkStore
from fourd.reconstruction.training.run_layout import CHECKPOINTS

UPLOAD_SECONDS = 300.0
"""Seconds from the end of an upload to the start of the next one."""
SUFFIX = " unfinished"

States = Mapping[str, str]
"""Maps the path of a file to its state; see :func:`fourd.pipeline.stored.manifest.file_state`."""


@dataclass(frozen=True)
class Unfinished:
    """Uploads the files of one stage while it runs, and copies the last upload to the machine that continues the stage.
    Used only for stages that write checkpoints.

    Attributes:
        store: the folder for intermediate results.
        cache: the local copy of the folder, in which the stage writes its files.
        name: name of the stage.
        key: key of the stage.
        seconds: time between two uploads.
    """

    store: WorkStore
    cache: Cache
    name: str
    key: str
    seconds: float

    def fetch(self, log: Log, track: Track) -> Manifest | None:
        """Copy the last upload to this machine. Returns None if there is no upload with the key of the stage, or if
        the upload cannot be copied."""
        try:
            manifest = self.store.read(self.name + SUFFIX)
            if manifest is None or manifest.key != self.key:
                return None
            self.cache.copy(self.store, [manifest], track)
            # The files are no longer recorded as copies of the upload, because the stage changes and removes them.
            self.cache.forget(manifest.name)
        except UserError as error:
            log(f"{self.name}: starts from the beginning, because the last upload cannot be copied: {error}")
            return None
        return manifest

    @contextmanager
    def uploaded(self, written: Callable[[], States], log: Log) -> Iterator[None]:
        """Upload the files of the stage in a thread whenever there are new checkpoints, until the ``with`` block ends.
        A failed upload is reported, and the stage continues.

        Args:
            written: returns the states of the files that the stage has written so far.
            log: prints a message.
        """
        last: States = {}

        def upload_new() -> None:
            nonlocal last
            states = written()
            if _checkpoints(states) not in ({}, _checkpoints(last)) and self._upload(states, log):
                last = states

        with called_every(self.seconds, upload_new):
            yield

    def remove(self) -> None:
        """Remove the last upload, because the stage has published its results."""
        manifest = self.store.read(self.name + SUFFIX)
        if manifest is not None:
            self.store.remove(manifest)

    def _upload(self, states: States, log: Log) -> bool:
        """Upload copies of the files, because the stage can change them during the upload. Returns True if the upload
        succeeded."""
        try:
            with self.cache.copies(self.name) as folder:
                for path in states:
                    if not (self.cache.root / path).is_symlink():
                        (folder / path).parent.mkdir(parents=True, exist_ok=True)
                        shutil.copy2(self.cache.root / path, folder / path)
                self.cache.publish(self.store, self.name + SUFFIX, self.key, list(states), copies=folder)
        except FileNotFoundError:
            # The stage has replaced a checkpoint during the copying. The next upload will contain the new one.
            return False
        except (OSError, UserError) as error:
            log(f"{self.name}: the checkpoints were not uploaded: {error}")
            return False
        return True


def _checkpoints(states: States) -> dict[str, str]:
    """Return the states of the files that mark complete checkpoints. These files are directly in a checkpoint folder,
    and are written after all other files of their checkpoint."""
    return {path: state for path, state in states.items() if PurePosixPath(path).parent.name == CHECKPOINTS}
