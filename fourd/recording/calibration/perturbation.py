"""Pose errors between two calibrations, and perturbed calibrations for tests of refinement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.calibration.scale import align_cameras


@dataclass(frozen=True)
class PoseError:
    """Error of a camera's pose: rotation error in degrees, and distance from the true camera centre in world units."""

    degrees: float
    distance: float


def pose_errors(truth: Mapping[str, Camera], cameras: Mapping[str, Camera]) -> dict[str, PoseError]:
    """Align ``cameras`` to ``truth`` by a similarity transform, and return the pose errors, keyed by camera name."""
    aligned = align_cameras(cameras, {name: truth[name] for name in cameras})
    return {name: _error(truth[name], aligned[name]) for name in cameras}


def perturb_cameras(
    cameras: Mapping[str, Camera], degrees: float, distance: float, rng: np.random.Generator
) -> dict[str, Camera]:
    """Rotate each camera by ``degrees`` about a random axis, and move it by ``distance`` in a random direction.

    The ``distance`` of each move is in world units.
    """
    moved = {}
    for name, camera in cameras.items():
        axis, shift = (_random_direction(rng) for _ in range(2))
        rotation = cv2.Rodrigues(np.radians(degrees) * axis)[0] @ camera.rotation
        moved[name] = replace(camera, rotation=rotation, translation=-rotation @ (camera.centre + distance * shift))
    return moved


def _random_direction(rng: np.random.Generator) -> np.ndarray:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _error(truth: Camera, camera: Camera) -> PoseError:
    rotation = cv2.Rodrigues(camera.rotation @ truth.rotation.T)[0]
    return PoseError(float(np.degrees(np.linalg.norm(rotation))), float(np.linalg.norm(camera.centre - truth.centre)))
