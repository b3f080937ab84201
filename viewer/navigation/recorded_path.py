"""A recorded camera path: poses and frames at an even pace, and its file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from fourd.errors import UserError
from fourd.files import write_text_atomically
from fourd.viewer.navigation.pose import Pose
from fourd.viewer.navigation.saved_views import pose_from_json, pose_to_json

FORMAT = "fourd-path"
VERSION = 1
RECORDED_FPS = 30.0
_MOST_BYTES = 256 << 20


@dataclass(frozen=True, eq=False)
class PathSample:
    """Where the viewer was, and which frame was shown."""

    pose: Pose
    frame: int


@dataclass(frozen=True, eq=False)
class RecordedPath:
    """Stops at ``fps`` a second."""

    stops: tuple[PathSample, ...]
    fps: float = RECORDED_FPS

    def save(self, path: Path) -> None:
        """Write a JSON file, whole or not at all."""
        content = {
            "format": FORMAT,
            "version": VERSION,
            "fps": self.fps,
            "stops": [{"frame": stop.frame, **pose_to_json(stop.pose)} for stop in self.stops],
        }
        write_text_atomically(path, json.dumps(content, indent=1))


class PathRecorder:
    """Takes a stop at every tick of RECORDED_FPS while it runs, whatever the pace of the pictures."""

    def __init__(self) -> None:
        self._stops: list[PathSample] = []
        self._seconds = 0.0

    @property
    def seconds(self) -> float:
        """How long it runs already."""
        return self._seconds

    def advance(self, seconds: float, pose: Pose, frame: int) -> None:
        """Let time pass; the viewer is at ``pose`` at its end."""
        self._seconds += seconds
        while len(self._stops) < self._seconds * RECORDED_FPS:
            self._stops.append(PathSample(pose, frame))

    def flight(self) -> RecordedPath:
        """What was recorded."""
        return RecordedPath(tuple(self._stops))


def load_recorded_path(path: Path) -> RecordedPath:
    """Read a recorded path. Raises UserError that names the file and the mend."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ValueError(f"expected at most {_MOST_BYTES} bytes")
        content = json.loads(path.read_text("utf-8"))
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise ValueError(f'expected "format": "{FORMAT}"')
        if content.get("version") != VERSION:
            raise ValueError(f"expected version {VERSION}, got {str(content.get('version'))[:20]}")
        stops = tuple(PathSample(pose_from_json(stop), _frame(stop["frame"])) for stop in content["stops"])
        fps = float(content["fps"])
        if not stops or not 0 < fps <= 1000:
            raise ValueError("expected at least one stop, and fps above 0")
    except OSError as error:
        raise UserError(f"{path}: expected a camera path, got '{(error.strerror or '').lower()}'; check it") from error
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise UserError(
            f"{path}: expected a camera path that the viewer recorded, got another file ({error})"
        ) from error
    return RecordedPath(stops, fps)


def _frame(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"expected frames as whole numbers from 0, got {str(value)[:20]}")
    return value
