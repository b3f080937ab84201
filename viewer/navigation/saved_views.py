"""Stores the last view of each scene in the user's state folder."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import platformdirs
from msgspec import Meta

from fourd.base.files import write_text_atomically
from fourd.base.json_file import Finite, Matrix, Vector, decode_json
from fourd.base.limits import read_json
from fourd.viewer.navigation.pose import Pose

_MAX_SCENES = 200


def default_file() -> Path:
    """Return the path of the file with saved views, in the platform's folder for application state."""
    return platformdirs.user_state_path("fourd") / "views.json"


def pose_to_json(pose: Pose) -> dict[str, Any]:
    """Convert a pose to JSON values."""
    return {
        "pivot": pose.pivot.tolist(),
        "rotation": pose.rotation.tolist(),
        "distance": pose.distance,
        "field_of_view": pose.field_of_view,
        "up": pose.up.tolist(),
        "offset": list(pose.offset),
    }


@dataclass(frozen=True)
class StoredPose:
    """The JSON of a pose, see :func:`pose_to_json`."""

    pivot: Vector
    rotation: Matrix
    distance: Annotated[float, Meta(gt=0, lt=1e30)]
    field_of_view: Annotated[float, Meta(gt=1e-3, lt=math.pi)]
    up: Vector
    offset: tuple[Finite, Finite]

    def __post_init__(self) -> None:
        if not abs(np.linalg.norm(self.up) - 1) < 1e-3:
            raise ValueError(f"up: expected a unit vector, got {self.up}")
        self.pose().camera(16, 16)  # raises ValueError if the rotation is not valid

    def pose(self) -> Pose:
        """Return the pose."""
        axes = np.array(self.pivot, np.float64), np.array(self.rotation, np.float64)
        return Pose(*axes, self.distance, self.field_of_view, np.array(self.up, np.float64), self.offset)


class SavedViews:
    """The last pose of each scene, stored in a file."""

    def __init__(self, file: Path) -> None:
        self._store = SceneStore(file)

    def load(self, scene: Path) -> Pose | None:
        """Return the saved pose of a scene, or None if no pose is saved."""
        try:
            return decode_json(self._store.load(scene), StoredPose).pose()
        except ValueError:
            return None

    def save(self, scene: Path, pose: Pose) -> None:
        """Save the pose."""
        self._store.save(scene, pose_to_json(pose))


class SceneStore:
    """JSON values for scenes, stored in a file.

    A file that cannot be read counts as empty. If the file cannot be written, the old one stays unchanged.
    """

    def __init__(self, file: Path) -> None:
        self._file = file

    def load(self, scene: Path) -> Any:
        """Return the value of a scene, or None if there is none. The content of the file is not trusted."""
        return self._read().get(_key(scene))

    def save(self, scene: Path, value: Any) -> None:
        """Store the value of a scene. The file keeps only the values of the 200 most recently saved scenes."""
        values = self._read()
        values.pop(_key(scene), None)
        values[_key(scene)] = value
        while len(values) > _MAX_SCENES:
            values.pop(next(iter(values)))
        try:
            write_text_atomically(self._file, json.dumps(values))
        except OSError:
            return

    def _read(self) -> dict[str, Any]:
        try:
            content = read_json(self._file)
        except (OSError, ValueError):
            return {}
        return content if isinstance(content, dict) else {}


def _key(scene: Path) -> str:
    return str(scene.resolve())
