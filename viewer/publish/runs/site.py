"""Provides the data of a run's page: state, curves, validation images and the scene."""

from __future__ import annotations

import io
import json
import os
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from cachetools import LRUCache
from PIL import Image

from fourd.base.errors import UserError
from fourd.base.limits import open_regular
from fourd.base.parallel import core_count
from fourd.base.progress import Terminal
from fourd.reconstruction.training.live.control import ACTIONS, Action, ControlRequest, write_request
from fourd.reconstruction.training.run_layout import VALIDATION, segment_folder
from fourd.scene.files.encoding import Tier
from fourd.scene.styles import Style
from fourd.viewer.publish.live import LiveScene
from fourd.viewer.publish.runs.history import RunHistory
from fourd.viewer.publish.runs.status import MAX_PICTURES, ActiveRun, describe, find_active
from fourd.viewer.publish.site import copy_training_page

STATUS_SECONDS = 1.0
"""Minimum time in seconds between two computations of the run's state and curves. Requests in between get the last
result."""
ASKED_SECONDS = 10.0
"""A new checkpoint is baked only if a page has requested the scene within this number of seconds."""
BAKING_SHARE = 0.02
"""Maximum fraction of the machine's CPU time that baking uses while the run trains."""
MAX_PICTURE_PIXELS = 1 << 26
MAX_PICTURE_WIDTH = 1600
_POLL_SECONDS = 0.5
_NICE = 19


class Refused(Exception):
    """Raised if a request to the training cannot be fulfilled. Its message is a sentence for the user."""


@dataclass(frozen=True)
class _Answers:
    """The last answers to requests for the run's state and curves, and the time at which they were computed."""

    active: ActiveRun
    status: bytes
    curves: bytes
    seconds: float


class RunSite:
    """Writes the page of a run, and answers its requests. All methods are thread-safe.

    Args:
        run: the run's folder.
        folder: the folder to which the page is written. It must not exist.
        tier: tier (quality, such as "stream") in which the scene is packed.
        console: prints the progress of baking.
        styles: the styles that the player offers, by name. If None, the player offers the presets.
    """

    def __init__(
        self, run: Path, folder: Path, tier: Tier, console: Terminal, styles: Mapping[str, Style] | None = None
    ) -> None:
        self.run = run
        self._title = run.resolve().name
        self._scene = LiveScene(run, folder, tier, console)
        copy_training_page(folder, self._title, styles)
        self._lock = threading.Lock()
        self._answers: _Answers | None = None
        self._history = RunHistory(run)
        self._history_of = run
        self._pictures: LRUCache[tuple[Path, int], bytes] = LRUCache(MAX_PICTURES)
        self._stopped = threading.Event()
        self._asked = -ASKED_SECONDS
        self._next_bake = 0.0
        self._is_baking = False

    def status(self) -> bytes:
        """Return the state of the run as JSON."""
        return self._current().status

    def curves(self) -> bytes:
        """Return the curves of the run as JSON."""
        return self._current().curves

    def picture(self, step: int, segment: int | None) -> bytes | None:
        """Return a validation image as JPEG, or None if there is no image of this step.

        Args:
            step: the training step of the image.
            segment: number of the segment, counted from 1, or None for a run without segments.
        """
        folder = self.run if segment is None else segment_folder(self.run, segment - 1)
        path = folder / VALIDATION / f"{step:07d}.png"
        try:
            key = (path, path.stat().st_mtime_ns)
        except OSError:
            return None
        with self._lock:
            found = self._pictures.get(key)
        if found is None:
            found = _read_picture(path)
            if found is None:
                return None
            with self._lock:
                self._pictures[key] = found
        return found

    def scene(self) -> bytes:
        """Return the state of the scene as JSON. A new checkpoint is baked only if this method has been called within
        the last ASKED_SECONDS seconds, that is, while a page shows the scene."""
        self._asked = time.monotonic()
        version, error = self._scene.version, self._scene.error
        steps = [int(name.partition(".")[0]) for name in version.split()]
        is_due = self._is_baking or self._may_bake()
        state = "baking" if is_due else "failed" if error else "ready" if version else "none"
        progress = self._scene.progress
        shown = None if progress is None else asdict(progress)
        return _to_json({"state": state, "step": max(steps, default=-1), "message": error, "progress": shown})

    def control(self, session: str, action: str) -> None:
        """Request an action, such as "pause" or "stop", from the training process.

        Args:
            session: id of the training session for which the request was made. A resumed run has a new session.
            action: one of ACTIONS.

        Raises Refused.
        """
        active = find_active(self.run)
        known = next((each for each in ACTIONS if each == action), None)
        if known is None:
            raise Refused(f"Expected one of the actions {', '.join(ACTIONS)}.")
        _require_running(active, session, known)
        try:
            write_request(active.folder, ControlRequest(session, known))
        except (OSError, UserError) as error:
            raise Refused(f"The request cannot be written into the folder of the run: {error}") from error

    def watch(self) -> None:
        """Bake new checkpoints while pages request the scene, until :meth:`stop` is called. On Linux, the calling
        thread gets a low priority, so that baking does not slow down training."""
        if sys.platform == "linux":
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        while not self._stopped.wait(_POLL_SECONDS):
            now = time.monotonic()
            if now - self._asked < ASKED_SECONDS and self._may_bake():
                self._bake()

    def stop(self) -> None:
        """Make :meth:`watch` return."""
        self._stopped.set()

    def _may_bake(self) -> bool:
        """Return whether there is a new checkpoint, and the share of the CPU that baking may use is not yet spent.

        After the end of training there is no such limit, also if it applied when the last scene was baked.
        """
        if not self._scene.has_news():
            return False
        return time.monotonic() >= self._next_bake or find_active(self.run).phase != "training"

    def _bake(self) -> None:
        self._is_baking = True
        used = time.process_time()
        try:
            self._scene.update()
            used = time.process_time() - used
            is_busy = find_active(self.run).phase == "training"
            self._next_bake = time.monotonic() + (used / core_count() / BAKING_SHARE if is_busy else 0.0)
        finally:
            # _is_baking is reset only after _next_bake has been set. In the opposite order, a call of scene() between
            # the two assignments could see the old _next_bake, and would report that baking has started again.
            self._is_baking = False

    def _current(self) -> _Answers:
        """Return the answers, after computing them again if they are older than STATUS_SECONDS."""
        with self._lock:
            now = time.monotonic()
            if self._answers is None or now - self._answers.seconds >= STATUS_SECONDS:
                active = find_active(self.run)
                if active.folder != self._history_of:
                    self._history, self._history_of = RunHistory(active.folder), active.folder
                self._history.update()
                status = _to_json(describe(self._title, active, self._history))
                self._answers = _Answers(active, status, _to_json(self._history.curves()), now)
            return self._answers


def _require_running(active: ActiveRun, session: str, action: Action) -> None:
    if active.state is None or not active.is_alive:
        raise Refused("The run does not train, so that there is nothing to pause, save or stop.")
    if active.state.session != session:
        raise Refused("Another training of this run has started since this page was updated. Try again.")
    if action == "save" and active.phase == "paused":
        raise Refused("The run is paused, and was saved when it was paused.")


def _read_picture(path: Path) -> bytes | None:
    """Return a validation image as a JPEG of moderate size, or None if the image is missing, damaged or too large."""
    try:
        with open_regular(path) as stream, Image.open(stream, formats=("PNG",)) as picture:
            if picture.width * picture.height > MAX_PICTURE_PIXELS:
                return None
            shown = picture.convert("RGB")
            shown.thumbnail((MAX_PICTURE_WIDTH, MAX_PICTURE_WIDTH))
            content = io.BytesIO()
            shown.save(content, "JPEG", quality=88)
            return content.getvalue()
    except (OSError, ValueError, SyntaxError, UserError, Image.DecompressionBombError):
        return None


def _to_json(content: object) -> bytes:
    return json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
