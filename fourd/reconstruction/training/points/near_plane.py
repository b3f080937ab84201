"""The near plane of a run: the camera depth below which no view shows anything.

A camera in a wall is seen by other cameras, so its body is reconstructed a few centimetres in front of its own lens.
Without a near plane between the lens and the subject, training would also explain everything that a view does not share
with the other views by points at its own lens, which no other view sees.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Array, Camera
from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.formats.ply import read_ply
from fourd.base.limits import read_json
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.run_layout import BACKGROUND, NEAR
from fourd.recording.capture.focus import median_distance, viewing_centre
from fourd.recording.capture.layout import sample_indices
from fourd.rendering.ops.moves import has_kernels, keep_beyond

NEAREST_SHARE = 0.5
"""Depth of the near plane, as a fraction of the depth of the nearest surface that a camera sees."""
MAX_SUBJECT_SHARE = 1 / 3
MIN_SUBJECT_SHARE = 0.02
"""Limits of the near plane's depth, as fractions of the median depth of the subject. The lower limit applies if a part
of the visual hull, which contains the subject but can be larger, reaches a camera."""
NEAREST_PERCENTILE = 0.1
"""Percentile of the depths of a camera's points that is taken as the depth of the nearest surface, because a few points
of a hull or of a triangulation are outliers."""
FEATURE_PERCENTILE = 2.0
MIN_FEATURES = 50
"""Minimum number of a camera's triangulated features from which the depth of its nearest surface is estimated."""
FALLBACK_SHARE = 0.05
SAMPLED_FRAMES = 24
SAMPLED_POINTS = 8192


def choose_near(
    cameras: Sequence[Camera],
    clouds: Iterable[NDArray[np.floating[Any]]],
    static_near: float | None = None,
) -> float:
    """Choose the depth of the near plane in world units.

    It is half the depth of the nearest surface that a camera sees: of the subject, whose points (N, 3) in some frames
    are ``clouds``, or of the static surfaces, for which ``static_near`` is the result of :func:`feature_near`. It is at
    most a third of the depth of the subject. If no camera sees a point of the subject, ``static_near`` alone decides,
    and without it, the near plane is at FALLBACK_SHARE of the median distance of the cameras from the point that they
    face.
    """
    found = [near for near in (subject_near(cameras, clouds), static_near) if near is not None]
    return min(found) if found else fallback_near(cameras)


def fallback_near(cameras: Sequence[Camera]) -> float:
    """Return the near plane of a capture of which no surface is known."""
    return FALLBACK_SHARE * median_distance(cameras, viewing_centre(cameras))


def sample_hull(folder: Path, frame_numbers: Sequence[int]) -> Iterator[NDArray[np.float32]]:
    """Yield points (N, 3) of up to SAMPLED_FRAMES evenly spaced frames from the ``FRAME.ply`` files in ``folder``."""
    for index in sample_indices(len(frame_numbers), SAMPLED_FRAMES):
        xyz = read_ply(folder / f"{frame_numbers[index]:06d}.ply").xyz
        yield xyz[:: max(1, len(xyz) // SAMPLED_POINTS)]


def subject_near(cameras: Sequence[Camera], clouds: Iterable[NDArray[np.floating[Any]]]) -> float | None:
    """Choose the near plane from the subject's points.

    Args:
        cameras: all cameras of the capture, held-out cameras included.
        clouds: points (N, 3) of some frames' visual hulls in world units.

    Returns:
        the depth in world units, or None if no camera sees a point.
    """
    depths: list[list[Array]] = [[] for _ in cameras]
    for xyz in clouds:
        for own, camera in zip(depths, cameras, strict=True):
            own.append(visible_depths(camera, xyz))
    seen = [np.concatenate(own) for own in depths if own and sum(map(len, own))]
    if not seen:
        return None
    nearest = min(float(np.percentile(own, NEAREST_PERCENTILE)) for own in seen)
    typical = float(np.median([np.median(own) for own in seen]))
    return float(np.clip(NEAREST_SHARE * nearest, MIN_SUBJECT_SHARE * typical, MAX_SUBJECT_SHARE * typical))


def feature_near(depths: Iterable[NDArray[np.floating[Any]]]) -> float | None:
    """Choose the near plane from the camera depths (N,) of the static surfaces that each camera sees itself. Returns
    None if no camera has enough of them."""
    nearest = [np.percentile(own, FEATURE_PERCENTILE) for own in depths if len(own) >= MIN_FEATURES]
    return NEAREST_SHARE * float(min(nearest)) if nearest else None


def visible_depths(camera: Camera, xyz: NDArray[np.floating[Any]]) -> Array:
    """Return the camera depths (M,) of those points of ``xyz`` (N, 3) that are inside the image."""
    pixels, depth = camera.project(xyz)
    return np.asarray(depth[camera.is_in_image(pixels, depth)])


def is_before_near(xyz: NDArray[np.floating[Any]], cameras: Sequence[Camera], near: float) -> NDArray[np.bool_]:
    """Return an (N,) mask of the points ``xyz`` (N, 3) that are inside the image of a camera and nearer than ``near``
    world units in front of it. A wall beside a camera is outside the camera's image, however near it is."""
    found = np.zeros(len(xyz), np.bool_)
    for camera in cameras:
        pixels, depth = camera.project(xyz)
        found |= camera.is_in_image(pixels, depth) & (depth < near)
    return found


def revert_moves_before_near(points: FramePoints, rows: Tensor, before: Tensor, camera: Camera, near: float) -> None:
    """Undo each move that took a point before the near plane of ``camera``.

    Args:
        points: the points of a cloud. Their positions are changed in place.
        rows: (M,) indices of the points that moved. All of them were visible in ``camera``.
        before: (M, 3) positions of the moved points before the move.
        camera: the camera whose view was trained.
        near: depth of the near plane in world units.
    """
    if has_kernels(rows, points.xyz, before):
        keep_beyond(rows, points.xyz, before, camera, near)
        return
    moved = points.xyz[rows]
    axis = torch.tensor(camera.forward, dtype=moved.dtype, device=moved.device)
    depth = (moved - torch.tensor(camera.centre, dtype=moved.dtype, device=moved.device)) @ axis
    points.parameters["xyz"][rows] = torch.where((depth < near)[:, None], before, moved)


def write_static_near(run: Path, near: float | None) -> None:
    """Store the result of :func:`feature_near` beside the background's points of a run."""
    write_text_atomically(run / BACKGROUND / NEAR, json.dumps({"near": near}) + "\n")


def read_static_near(run: Path) -> float | None:
    """Read what :func:`write_static_near` stored in the folder of a run. Returns None if the run has no background."""
    path = run / BACKGROUND / NEAR
    if not path.exists():
        return None
    state = read_json(path)
    near = state.get("near", "nothing") if isinstance(state, dict) else "nothing"
    if near is not None and not (isinstance(near, float) and 0 < near < float("inf")):
        raise UserError(f'{path}: expected {{"near": depth}} with a depth above 0, got {near}; delete the folder')
    return near
