"""Records camera paths, and reads and writes their files. Each sample of a path is a pose and a frame index."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.limits import read_json
from fourd.viewer.navigation.pose import Pose
from fourd.viewer.navigation.saved_views import pose_from_json, pose_to_json

FORMAT = "fourd-path"
VERSION = 1
RECORDED_FPS = 30.0
_MAX_BYTES = 256 << 20


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
            "format": FORMAT,
            "version": VERSION,
            "fps": self.fps,
            "stops": [{"frame": sample.frame, **pose_to_json(sample.pose)} for sample in self.samples],
        }
        write_text_atomically(path, json.dumps(content, indent=1))


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


def load_recorded_path(path: Path) -> RecordedPath:
    """Read a recorded path. Raises UserError, which names the file and the fix, if the file is not valid."""
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ValueError(f"expected at most {_MAX_BYTES} bytes")
        content = read_json(path, _MAX_BYTES)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise ValueError(f'expected "format": "{FORMAT}"')
        if content.get("version") != VERSION:
            raise ValueError(f"expected version {VERSION}, got {str(content.get('version'))[:20]}")
        samples = tuple(PathSample(pose_from_json(item), _frame_index(item["frame"])) for item in content["stops"])
        fps = float(content["fps"])
        if not samples or not 0 < fps <= 1000:
            raise ValueError("expected at least one entry in stops, and an fps value above 0 and up to 1000")
    except OSError as error:
        reason = (error.strerror or "").lower()
        raise UserError(f"{path}: expected a camera path, got '{reason}'; check the file") from error
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise UserError(f"{path}: expected a camera path recorded by the viewer, got another file ({error})") from error
    return RecordedPath(samples, fps)


def _frame_index(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"expected frames as whole numbers from 0, got {str(value)[:20]}")
    return value
