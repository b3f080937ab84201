"""The camera path that the user makes in the window, key frame by key frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fourd.base.errors import UserError
from fourd.viewer.camera_paths.keys import MAX_KEYS, KeyedPath, KeyFrame, evenly_spaced
from fourd.viewer.camera_paths.motion import Easing
from fourd.viewer.camera_paths.plan import played_frames
from fourd.viewer.camera_paths.reading import read_own_path
from fourd.viewer.navigation.pose import Pose
from fourd.viewer.navigation.recorded_path import PathSample, RecordedPath

DEFAULT_STEP_S = 2.0
"""Time between two key frames, until the user changes it."""
MIN_STEP_S, MAX_STEP_S = 0.05, 60.0
_LOADED_KEYS = 32
"""Number of key frames that replace the samples of a recorded path."""


@dataclass(frozen=True, eq=False)
class EditedKey:
    """A key frame.

    Attributes:
        pose: the view.
        frame: index of the scene's frame.
        step_s: time in seconds since the key frame before. For the first key frame, it is the time that a closed path
            needs from the last key frame to the first.
        easing: see :class:`~fourd.viewer.camera_paths.keys.KeyFrame`.
    """

    pose: Pose
    frame: float
    step_s: float = DEFAULT_STEP_S
    easing: Easing = "smooth"


class PathEditor:
    """A path of key frames that can be changed and played.

    Attributes:
        keys: the key frames in the order of the path.
        is_loop: whether the camera returns to the first key frame.
        has_frames: whether the scene shows the frames of the key frames. Otherwise, it plays at its own speed.
        playing_s: time on the path while it is played, or None.
    """

    def __init__(self) -> None:
        self.keys: tuple[EditedKey, ...] = ()
        self.is_loop = False
        self.has_frames = True
        self.playing_s: float | None = None
        self._path: KeyedPath | None = None

    @property
    def is_playing(self) -> bool:
        """Whether the path is being played."""
        return self.playing_s is not None

    def add(self, pose: Pose, frame: int) -> str:
        """Add a view to the end of the path. Returns a message for the user."""
        if len(self.keys) == MAX_KEYS:
            return f"expected at most {MAX_KEYS} key frames, got another one; remove one in the section Camera path"
        self._set((*self.keys, EditedKey(pose, float(frame))))
        return f"key frame {len(self.keys)} of the camera path"

    def remove(self, index: int) -> None:
        """Remove a key frame."""
        self._set((*self.keys[:index], *self.keys[index + 1 :]))

    def change(self, index: int, *, step_s: float | None = None, easing: Easing | None = None) -> None:
        """Change the time since the key frame before, or the easing of a key frame."""
        key = self.keys[index]
        step = key.step_s if step_s is None else min(max(step_s, MIN_STEP_S), MAX_STEP_S)
        changed = replace(key, step_s=step, easing=key.easing if easing is None else easing)
        self._set((*self.keys[:index], changed, *self.keys[index + 1 :]))

    def set_loop(self, is_loop: bool) -> None:
        """Set whether the camera returns to the first key frame."""
        self.is_loop = is_loop
        self._set(self.keys)

    def set_has_frames(self, has_frames: bool) -> None:
        """Set whether the scene shows the frames of the key frames."""
        self.has_frames = has_frames
        self._set(self.keys)

    def path(self) -> KeyedPath | None:
        """Return the path, or None without key frames."""
        if self._path is None and self.keys:
            seconds = np.cumsum([0.0, *(key.step_s for key in self.keys[1:])])
            keys = tuple(
                KeyFrame(key.pose, float(time), key.frame if self.has_frames else None, key.easing)
                for key, time in zip(self.keys, seconds, strict=True)
            )
            is_loop = self.is_loop and len(keys) > 1
            self._path = KeyedPath(keys, loop_seconds=float(seconds[-1]) + self.keys[0].step_s if is_loop else None)
        return self._path

    def recording(self, frame_count: int, fps: float) -> RecordedPath | None:
        """Return the images of the path through a scene with ``frame_count`` frames at ``fps`` per second, or None
        without key frames."""
        path = self.path()
        if path is None:
            return None
        images = path.path()
        samples = images.samples
        if not images.has_frames:
            shown = played_frames(len(samples), range(frame_count), fps / images.fps)
            samples = tuple(PathSample(each.pose, frame) for each, frame in zip(samples, shown, strict=True))
        return RecordedPath(samples, images.fps)

    def toggle(self) -> None:
        """Play the path from its start, or stop it."""
        self.playing_s = 0.0 if self.playing_s is None and self.keys else None

    def advance(self, seconds: float) -> PathSample | None:
        """Advance the path while it is played. Returns the view at the new time, or None if no path is played. A path
        that is not closed stops at its end."""
        path = self.path()
        if self.playing_s is None or path is None:
            self.playing_s = None
            return None
        time = self.playing_s + seconds
        if time >= path.duration and path.loop_seconds is None:
            self.playing_s = None
            return path.at(np.array([path.duration]))[0]
        self.playing_s = time % path.duration if path.duration > 0 else 0.0
        return path.at(np.array([self.playing_s]))[0]

    def save(self, target: Path) -> None:
        """Write the path to a file atomically. Without key frames, nothing is written."""
        path = self.path()
        if path is not None:
            path.save(target)

    def load(self, source: Path) -> None:
        """Replace the path by that of a file. Of a path that was recorded image by image, some images become key
        frames. Raises UserError."""
        stored = read_own_path(source)
        loop = None
        if isinstance(stored, KeyedPath):
            keys, loop = stored.keys, stored.loop_seconds
        else:
            keys = evenly_spaced(stored.samples, stored.fps, _LOADED_KEYS)
        first = DEFAULT_STEP_S if loop is None else loop - keys[-1].seconds
        steps = [first, *np.diff([key.seconds for key in keys])]
        self.is_loop, self.has_frames = loop is not None, any(key.frame is not None for key in keys)
        self._set(
            tuple(
                EditedKey(key.pose, key.frame or 0.0, float(step), key.easing)
                for key, step in zip(keys, steps, strict=True)
            )
        )

    def try_load(self, source: Path) -> str:
        """Load a file, and return a message for the user. If the file is not valid, the path does not change."""
        try:
            self.load(source)
        except UserError as error:
            return str(error)
        return f"{source}: {len(self.keys)} key frames; press Y to play the path"

    def _set(self, keys: tuple[EditedKey, ...]) -> None:
        self.keys, self._path, self.playing_s = keys, None, None
