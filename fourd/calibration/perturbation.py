"""How far one calibration is from another, and calibrations that are off by a known amount, to try refinement on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fourd.calibration.structure_from_motion import placed
from fourd.cameras import Camera


@dataclass(frozen=True)
class PoseError:
    """How far a camera is from where it should be: its rotation in degrees, its centre in world units."""

    degrees: float
    distance: float


def pose_errors(truth: Mapping[str, Camera], cameras: Mapping[str, Camera]) -> dict[str, PoseError]:
    """The errors of ``cameras`` after a similarity has brought them as near ``truth`` as it can.

    Cameras of both by the same names; a common turn, shift or scale of all of them counts as no error.
    """
    moved = placed(cameras, {name: truth[name] for name in cameras})
    return {name: _error(truth[name], moved[name]) for name in cameras}


def perturb_cameras(
    cameras: Mapping[str, Camera], degrees: float, distance: float, rng: np.random.Generator
) -> dict[str, Camera]:
    """Each camera turned about its centre by ``degrees`` and moved by ``distance`` world units, both any way."""
    moved = {}
    for name, camera in cameras.items():
        axis, shift = (_direction(rng) for _ in range(2))
        rotation = cv2.Rodrigues(np.radians(degrees) * axis)[0] @ camera.rotation
        moved[name] = replace(camera, rotation=rotation, translation=-rotation @ (camera.centre + distance * shift))
    return moved


def _direction(rng: np.random.Generator) -> np.ndarray:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _error(truth: Camera, camera: Camera) -> PoseError:
    turn = cv2.Rodrigues(camera.rotation @ truth.rotation.T)[0]
    return PoseError(float(np.degrees(np.linalg.norm(turn))), float(np.linalg.norm(camera.centre - truth.centre)))
