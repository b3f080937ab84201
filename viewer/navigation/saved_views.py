"""Stores the last view of each scene in the user's state folder."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from fourd.base.files import write_text_atomically
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


def pose_from_json(content: Any) -> Pose:
    """Return the pose that :func:`pose_to_json` has converted to ``content``. Raises ValueError if ``content`` is not
    a valid pose."""
    try:
        pose = Pose(
            pivot=_numbers(content["pivot"], (3,)),
            rotation=_numbers(content["rotation"], (3, 3)),
            distance=float(_numbers(content["distance"], ())),
            field_of_view=float(_numbers(content["field_of_view"], ())),
            up=_numbers(content["up"], (3,)),
            offset=tuple(_numbers(content["offset"], (2,)).tolist()),
        )
    except (KeyError, TypeError, OverflowError) as error:
        raise ValueError(f"expected a pose, got {str(content)[:60]}") from error
    if not (pose.distance > 0 and 1e-3 < pose.field_of_view < math.pi and abs(np.linalg.norm(pose.up) - 1) < 1e-3):
        raise ValueError("expected distance above 0, field_of_view between 0.001 and pi, and a unit vector as up")
    pose.camera(16, 16)  # raises an error if the rotation is not valid
    return pose


class SavedViews:
    """The last pose of each scene, stored in a file.

    A file that cannot be read counts as empty. If the file cannot be written, the old one stays unchanged.
    """

    def __init__(self, file: Path) -> None:
        self._file = file

    def load(self, scene: Path) -> Pose | None:
        """Return the saved pose of a scene, or None if no pose is saved."""
        try:
            return pose_from_json(self._read().get(_key(scene)))
        except ValueError:
            return None

    def save(self, scene: Path, pose: Pose) -> None:
        """Save the pose. The file keeps only the poses of the 200 most recently saved scenes."""
        views = self._read()
        views.pop(_key(scene), None)
        views[_key(scene)] = pose_to_json(pose)
        while len(views) > _MAX_SCENES:
            views.pop(next(iter(views)))
        try:
            write_text_atomically(self._file, json.dumps(views))
        except OSError:
            return

    def _read(self) -> dict[str, Any]:
        try:
            content = read_json(self._file)
        except (OSError, ValueError, RecursionError):
            return {}
        return content if isinstance(content, dict) else {}


def _key(scene: Path) -> str:
    return str(scene.resolve())


def _numbers(value: Any, shape: tuple[int, ...]) -> np.ndarray[Any, np.dtype[np.float64]]:
    array = np.array(value, np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers of shape {shape}, got {str(value)[:60]}")
    return array
