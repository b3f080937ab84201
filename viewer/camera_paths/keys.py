"""Camera paths of key frames, and their files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from fourd.base.files import write_text_atomically
from fourd.base.json_file import decode_json
from fourd.viewer.camera_paths.motion import Easing, Motion
from fourd.viewer.camera_paths.path import CameraPath
from fourd.viewer.navigation.pose import Pose
from fourd.viewer.navigation.recorded_path import RECORDED_FPS, PathSample
from fourd.viewer.navigation.saved_views import StoredPose, pose_to_json

Array = NDArray[np.float64]

MAX_SECONDS = 86400.0
MAX_KEYS = 10_000
MAX_IMAGES = 100_000
"""Maximum number of images of a path. At 30 images per second, they are a video of 55 minutes."""


@dataclass(frozen=True, eq=False)
class KeyFrame:
    """A pose through which a path leads.

    Attributes:
        pose: the pose.
        seconds: time on the path, at least 0.
        frame: the frame of the scene that is visible at this time, as an index from 0, which can be fractional. None if
            the path does not say so.
        easing: "smooth": the camera passes through. "stop": its speed falls to 0 and rises again. "cut": the camera
            rests until the next key frame, and then jumps there.
    """

    pose: Pose
    seconds: float
    frame: float | None = None
    easing: Easing = "smooth"


@dataclass(frozen=True, eq=False)
class KeyedPath:
    """A path through key frames.

    Attributes:
        keys: key frames, at least one, with increasing times.
        fps: images per second.
        loop_seconds: time at which the camera is back at the first key frame; None if the path ends at the last one.

    Raises:
        ValueError: if the times do not increase, or if the path is too long.
    """

    keys: tuple[KeyFrame, ...]
    fps: float = RECORDED_FPS
    loop_seconds: float | None = None

    def __post_init__(self) -> None:
        times = [key.seconds for key in self.keys] + ([] if self.loop_seconds is None else [self.loop_seconds])
        for index, (before, after) in enumerate(pairwise(times)):
            if not after > before:
                name = f"keys[{index + 1}], seconds" if index + 1 < len(self.keys) else "loop_seconds"
                raise ValueError(f"{name}: expected more than {before:g} of the key before it, got {after:g}")
        if self.image_count > MAX_IMAGES:
            raise ValueError(f"keys: expected at most {MAX_IMAGES} images, got {self.image_count}")

    @property
    def duration(self) -> float:
        """Duration in seconds, from the first key frame to the last one or back to the first one."""
        return (self.keys[-1].seconds if self.loop_seconds is None else self.loop_seconds) - self.keys[0].seconds

    @property
    def image_count(self) -> int:
        """Number of images. A closed path has no image at its end, where it joins its beginning."""
        return max(1, round(self.duration * self.fps) + (self.loop_seconds is None))

    def at(self, seconds: Array) -> tuple[PathSample, ...]:
        """Return pose and frame at times (N,) after the first key frame, in seconds. Frames are rounded."""
        times = np.asarray(seconds, np.float64) + self.keys[0].seconds
        motion = Motion(
            [key.pose for key in self.keys],
            np.array([key.seconds for key in self.keys]),
            [key.easing for key in self.keys],
            self.loop_seconds,
        )
        frames = np.rint(self._frames(times)).astype(int)
        return tuple(PathSample(pose, int(frame)) for pose, frame in zip(motion.at(times), frames, strict=True))

    def path(self) -> CameraPath:
        """Return the images of the path."""
        count, is_loop = self.image_count, self.loop_seconds is not None
        # The number of images is rounded, but the last image is always the last key frame.
        times = np.arange(count) * self.duration / (count if is_loop else max(count - 1, 1))
        has_frames = any(key.frame is not None for key in self.keys)
        return CameraPath(
            self.at(times), self.fps, has_frames, is_loop, curve=lambda shares: self.at(shares * self.duration)
        )

    def _frames(self, times: Array) -> Array:
        """Return the frame indices (N,), which are monotone between two key frames. Key frames without a frame have no
        influence."""
        stated = [(key.seconds, key.frame) for key in self.keys if key.frame is not None]
        if self.loop_seconds is not None and self.keys[0].frame is not None:
            stated.append((self.loop_seconds, self.keys[0].frame))
        if len(stated) < 2:
            return np.full(len(times), stated[0][1] if stated else 0.0)
        seconds, frames = np.array(stated).T
        return np.asarray(PchipInterpolator(seconds, frames)(np.clip(times, seconds[0], seconds[-1])), np.float64)

    def to_json(self) -> dict[str, Any]:
        """Return the content of the path's file."""
        return {
            "format": "fourd-path",
            "version": 2,
            "fps": self.fps,
            "loop_seconds": self.loop_seconds,
            "keys": [
                {"seconds": key.seconds, "frame": key.frame, "easing": key.easing, **pose_to_json(key.pose)}
                for key in self.keys
            ],
        }

    def save(self, path: Path) -> None:
        """Write the path to a JSON file atomically."""
        write_text_atomically(path, json.dumps(self.to_json(), indent=1))


def keys_from_json(content: Any) -> KeyedPath:
    """Convert the JSON of :meth:`KeyedPath.to_json`. Raises ValueError for other content."""
    stored = decode_json(content, _StoredPath)
    keys = tuple(KeyFrame(key.pose(), key.seconds, key.frame, key.easing) for key in stored.keys)
    return KeyedPath(keys, stored.fps, stored.loop_seconds)


def evenly_spaced(samples: Sequence[PathSample], fps: float, count: int) -> tuple[KeyFrame, ...]:
    """Return at most ``count`` of the samples, which is at least 2, as key frames. The first and the last sample are
    among them."""
    chosen = np.unique(np.rint(np.linspace(0, len(samples) - 1, min(count, len(samples)))).astype(int))
    return tuple(KeyFrame(samples[i].pose, float(i) / fps, float(samples[i].frame)) for i in chosen)


@dataclass(frozen=True)
class _StoredKey(StoredPose):
    seconds: Annotated[float, Meta(ge=0, le=MAX_SECONDS)]
    frame: Annotated[float, Meta(ge=0, le=1 << 31)] | None = None
    easing: Easing = "smooth"


@dataclass(frozen=True)
class _StoredPath:
    format: Literal["fourd-path"]
    version: Literal[2]
    fps: Annotated[float, Meta(gt=0, le=1000)]
    keys: Annotated[tuple[_StoredKey, ...], Meta(min_length=1, max_length=MAX_KEYS)]
    loop_seconds: Annotated[float, Meta(gt=0, le=MAX_SECONDS)] | None = None
