"""Records camera paths image by image. Each sample of a path is a pose and a frame index."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from fourd.base.files import write_text_atomically
from fourd.base.json_file import decode_json
from fourd.viewer.navigation.pose import Pose
from fourd.viewer.navigation.saved_views import StoredPose, pose_to_json

RECORDED_FPS = 30.0
MAX_PATH_BYTES = 256 << 20
"""Maximum size of a path file in bytes."""


@dataclass(frozen=True, eq=False)
class PathSample:
    """The pose and the frame index of one sample of a path."""

    pose: Pose
    frame: int


@dataclass(frozen=True, eq=False)
class RecordedPath:
    """A camera path that the user has recorded in the viewer, with ``fps`` samples per second."""

    samples: tuple[PathSample, ...]
    fps: float = RECORDED_FPS

    def save(self, path: Path) -> None:
        """Write the path to a JSON file atomically."""
        content = {
            "format": "fourd-path",
            "version": 1,
            "fps": self.fps,
            "stops": [{"frame": sample.frame, **pose_to_json(sample.pose)} for sample in self.samples],
        }
        write_text_atomically(path, json.dumps(content, indent=1))


@dataclass(frozen=True)
class _Stop(StoredPose):
    frame: Annotated[int, Meta(ge=0)]


@dataclass(frozen=True)
class _StoredPath:
    format: Literal["fourd-path"]
    version: Literal[1]
    fps: Annotated[float, Meta(gt=0, le=1000)]
    stops: Annotated[tuple[_Stop, ...], Meta(min_length=1)]


class PathRecorder:
    """Records a path with RECORDED_FPS samples per second, no matter how often :meth:`advance` is called."""

    def __init__(self) -> None:
        self._samples: list[PathSample] = []
        self._seconds = 0.0

    @property
    def seconds(self) -> float:
        """Duration of the recording in seconds."""
        return self._seconds

    def advance(self, seconds: float, pose: Pose, frame: int) -> None:
        """Advance the recording by ``seconds``. ``pose`` and ``frame`` are the values at the end of this time step."""
        self._seconds += seconds
        while len(self._samples) < self._seconds * RECORDED_FPS:
            self._samples.append(PathSample(pose, frame))

    def path(self) -> RecordedPath:
        """Return the path with all samples recorded so far."""
        return RecordedPath(tuple(self._samples))


def recording_from_json(content: Any) -> RecordedPath:
    """Convert the JSON of :meth:`RecordedPath.save`. Raises ValueError for other content."""
    stored = decode_json(content, _StoredPath)
    return RecordedPath(tuple(PathSample(stop.pose(), stop.frame) for stop in stored.stops), stored.fps)
