"""A viewer's state apart from its window: the open scene, what plays, where one stands, and how it looks."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from fourd.baking import BakedFrame, SceneManifest
from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.navigation.pose import Pose, between, facing, pose_of
from fourd.viewer.navigation.up_direction import estimate_up
from fourd.viewer.playback.clock import Playback
from fourd.viewer.playback.prefetch import RING_BYTES, BakedFrameSource, FramePrefetcher
from fourd.viewer.playback.sources import RunSource, open_frame_source

GLIDE_SECONDS = 0.7
_LOOK_EVERY = 1.0
"""Seconds between looks for a new checkpoint."""


class LoadedScene:
    """A scene that is open: its frames as they come, its cameras, and its own start."""

    def __init__(self, path: Path, source: BakedFrameSource) -> None:
        self.path = path
        self.manifest: SceneManifest = source.manifest
        self._run = source if isinstance(source, RunSource) else None
        # Frames of a run are baked where they are read: as few as can be, for training needs the processor.
        self.stream = FramePrefetcher(source, 0 if self._run else RING_BYTES)
        self.up = estimate_up(self.manifest.cameras) if self.manifest.cameras else np.array([0.0, 0.0, 1.0])
        self._checkpoint = self._run.checkpoint if self._run else ""
        self._looked = time.monotonic()

    @property
    def checkpoint(self) -> str:
        """The run's checkpoint that is shown; empty for a `.4dv`."""
        return self._checkpoint

    def start(self, size: tuple[int, int]) -> Pose:
        """The first camera's view, or one of the whole scene where there are no cameras."""
        if self.manifest.cameras:
            return self.camera_pose(0, size)
        lower, upper = (np.asarray(corner) for corner in self.manifest.bounds)
        reach = max(float(np.linalg.norm(upper - lower)), 1e-3)
        middle = (lower + upper) / 2
        side = np.array([0.0, -1.0, 0.0]) if abs(self.up[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
        return facing(middle + 1.2 * reach * side, middle, self.up, np.radians(50))

    def camera_pose(self, index: int, size: tuple[int, int]) -> Pose:
        """What a camera of the capture sees."""
        return pose_of(self.manifest.cameras[index], self.manifest.focus, self.up, size)

    def look_for_checkpoint(self) -> bool:
        """Whether a run has a new checkpoint; its frames are then read again."""
        now = time.monotonic()
        if self._run is None or now - self._looked < _LOOK_EVERY:
            return False
        self._looked = now
        newest = self._run.checkpoint
        if newest in ("", self._checkpoint):
            return False
        self._checkpoint = newest
        self.stream.forget()
        return True

    def close(self) -> None:
        self.stream.close()


class Session:
    """What the panel and the keys act on. Scenes are opened in the background: the open one stays meanwhile."""

    def __init__(self, settings: DisplaySettings) -> None:
        """``settings.layers`` 0 stands for what each scene asks for."""
        self.settings = settings
        self.scene: LoadedScene | None = None
        self.playback = Playback(1, 30.0)
        self.pose: Pose | None = None
        self.message = ""
        self.failure: Exception | None = None  # why the last opening failed
        self.waiting = False
        self._opening: threading.Thread | None = None
        self._opened: LoadedScene | Exception | None = None
        self._glide: tuple[Pose, Pose, float] | None = None
        self._scaled: tuple[BakedFrame, DisplaySettings, BakedFrame] | None = None
        self._seen: tuple[Pose, tuple[int, int], Camera] | None = None
        self._shown: BakedFrame | None = None
        self._chose_layers = settings.layers > 0

    @property
    def opening(self) -> bool:
        """Whether a scene is being opened."""
        return self._opening is not None

    @property
    def gliding(self) -> bool:
        return self._glide is not None

    def open(self, path: Path) -> None:
        """Begin to open a scene or a run."""
        if self._opening is not None:
            return
        self._opened = None
        self._opening = threading.Thread(target=self._open, args=(path,), name="opener", daemon=True)
        self._opening.start()

    def settle_opening(self, wait: bool = False) -> LoadedScene | None:
        """The scene that has just been opened, once; a failure goes to ``message`` and the open scene stays."""
        if self._opening is None or (self._opening.is_alive() and not wait):
            return None
        self._opening.join()
        self._opening, opened = None, self._opened
        if isinstance(opened, LoadedScene):
            return opened
        self.failure, self.message = opened, str(opened)
        return None

    def show(self, scene: LoadedScene, pose: Pose) -> None:
        """Take over a scene; the one before it is closed."""
        if self.scene is not None:
            self.scene.close()
        self.scene, self.pose = scene, pose
        manifest = scene.manifest
        self.playback = Playback(manifest.frame_count, manifest.fps, playing=not scene.checkpoint)
        if not self._chose_layers:
            self.settings = replace(self.settings, layers=manifest.layers)
        self._glide, self._scaled, self._shown = None, None, None
        self.message = ""

    def choose_layers(self, layers: int) -> None:
        """Set K; the scenes' own K is not taken any more."""
        self._chose_layers = True
        self.settings = replace(self.settings, layers=layers)

    def glide_to(self, pose: Pose) -> None:
        """Move there over GLIDE_SECONDS."""
        if self.pose is not None:
            self._glide = (self.pose, pose, 0.0)

    def move(self, pose: Pose) -> None:
        """Stand there at once; a glide ends."""
        self.pose, self._glide = pose, None

    def advance(self, seconds: float) -> bool:
        """Let time pass: play and glide, unless the frame that should be seen is not there yet.

        Returns whether a run has a new checkpoint, whose frames come next.
        """
        renewed = self.scene is not None and self.scene.look_for_checkpoint()
        if not self.waiting:
            self.playback.advance(seconds)
        if self._glide is not None:
            start, end, share = self._glide
            share = min(1.0, share + seconds / GLIDE_SECONDS)
            self.pose = between(start, end, share)
            self._glide = (start, end, share) if share < 1 else None
        return renewed

    def request(self, size: tuple[int, int], wait: bool = False) -> RenderRequest | None:
        """What to draw in a picture of ``size``; None while nothing is open or nothing has been read yet.

        While a frame is being read, the one before it stays and ``waiting`` is set. A frame that
        cannot be read leaves its reason in ``message``.
        """
        if self.scene is None or self.pose is None:
            return None
        frame = self._frame(wait)
        if frame is None:
            return None
        return RenderRequest(self._applied(frame), self._camera(self.pose, size), self.scene.manifest, self.settings)

    def close(self) -> None:
        """Stop what goes on in the background and close the scene."""
        if self._opening is not None:
            self._opening.join()
            self._opening = None
            if isinstance(self._opened, LoadedScene):
                self._opened.close()
        if self.scene is not None:
            self.scene.close()
            self.scene = None

    def _frame(self, wait: bool) -> BakedFrame | None:
        assert self.scene is not None
        try:
            found = self.scene.stream.get(self.playback.frame, self.playback.direction, wait)
        except UserError as error:
            if wait:
                raise
            self.message, self.waiting = str(error), False
            return self._shown
        self.waiting = found is None
        if found is not None:
            self._shown = found
        return self._shown

    def _camera(self, pose: Pose, size: tuple[int, int]) -> Camera:
        """The same object as long as nothing moves: renderers then know that their order still holds."""
        if self._seen is None or self._seen[0] is not pose or self._seen[1] != size:
            self._seen = (pose, size, pose.camera(*size))
        return self._seen[2]

    def _applied(self, frame: BakedFrame) -> BakedFrame:
        """The frame in the settings's scales; the same object as long as both are the same."""
        scales = (self.settings.point_scale, self.settings.density_scale)
        if self._scaled is not None:
            source, settings, scaled = self._scaled
            if source is frame and (settings.point_scale, settings.density_scale) == scales:
                return scaled
        applied = self.settings.applied(frame)
        self._scaled = (frame, self.settings, applied)
        return applied

    def _open(self, path: Path) -> None:
        try:
            self._opened = LoadedScene(path, open_frame_source(path))
        except Exception as error:  # told where the window is: nothing may be lost in a thread
            self._opened = error
