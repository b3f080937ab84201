"""Scale, origin and axes of calibrated cameras, from a measured distance or a chessboard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.calibration.chessboard import Board, board_pose

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Distance:
    """Measured distance in metres between the centres of two cameras; ``first`` and ``second`` are camera names."""

    first: str
    second: str
    metres: float


@dataclass(frozen=True)
class WorldFrame:
    """Cameras in the world that the user has chosen.

    Attributes:
        cameras: the cameras by name.
        is_metric: whether the world unit is a metre because of the user's measurement.
        notes: lines for the log.
    """

    cameras: dict[str, Camera]
    is_metric: bool
    notes: tuple[str, ...]


def set_world_frame(
    cameras: Mapping[str, Camera], pictures: Mapping[str, Picture], distance: Distance | None, board: Board | None
) -> WorldFrame:
    """Scale the cameras to a measured distance, and align them to a chessboard; both steps are optional.

    Args:
        cameras: cameras by name, with the distortion of the images.
        pictures: one RGB image (H, W, 3) per camera, by name; used only to find the board.
        distance: measured distance between two cameras, or None to skip the scaling.
        board: chessboard in the images, or None to skip the alignment.

    Raises:
        UserError: if ``distance`` has an unknown camera name or is not positive, or no image shows the board.
    """
    moved, is_metric, notes = dict(cameras), distance is not None, []
    if distance is not None:
        moved = scale_cameras(moved, distance)
        notes.append(f"scaled: {distance.first} and {distance.second} are {distance.metres:g} m apart")
    if board is not None:
        poses = _board_poses(moved, pictures, board)
        moved, is_metric = align_cameras(moved, poses), is_metric or len(poses) > 1
        notes.append(
            f"aligned to the chessboard in the images of {', '.join(poses)}: origin at a corner, z normal to the board"
        )
        if not is_metric:
            notes.append(
                "the board is visible in one camera only, so the scale is unknown; give --scale, or show the board to "
                "two cameras"
            )
    return WorldFrame(moved, is_metric, tuple(notes))


def scale_cameras(cameras: Mapping[str, Camera], distance: Distance) -> dict[str, Camera]:
    """Scale all cameras to metres, so that the two cameras in ``distance`` are as far apart as measured.

    Raises:
        UserError: if a name is unknown, both names are the same camera, or the distance is not positive.
    """
    names = (distance.first, distance.second)
    for name in names:
        if name not in cameras:
            raise UserError(f"distance: expected two camera names among {', '.join(cameras)}, got '{name}'")
    first, second = (cameras[name].centre for name in names)
    length = float(np.linalg.norm(first - second))
    if not (np.isfinite(distance.metres) and distance.metres > 0 and length > 0):
        raise UserError(
            f"{names[0]}, {names[1]}: expected two cameras at different positions and a distance above 0, got "
            f"{distance.metres:g} m; measure between the centres of the lenses"
        )
    return {
        name: replace(camera, translation=camera.translation * distance.metres / length)
        for name, camera in cameras.items()
    }


def align_cameras(cameras: Mapping[str, Camera], poses: Mapping[str, Camera]) -> dict[str, Camera]:
    """Transform all cameras into the world in which some of them have the given ``poses``.

    The transformation is a similarity. One given pose determines its rotation and translation, but not its scale, which
    is then 1. Two or more given poses also determine the scale. If several poses are given, each of them determines a
    rotation of the world, and the mean of these rotations is used. The scale and the translation are then a
    least-squares fit of the camera centres.

    Raises:
        UserError: if no name in ``poses`` is a name in ``cameras``.
    """
    known = [name for name in poses if name in cameras]
    if not known:
        raise UserError(
            "board: expected an image of a calibrated camera that shows the board, got none; "
            "show the board to a calibrated camera"
        )
    u, _, vt = np.linalg.svd(sum(poses[name].rotation.T @ cameras[name].rotation for name in known))
    R_new_old = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    old = np.stack([R_new_old @ cameras[name].centre for name in known])
    new = np.stack([poses[name].centre for name in known])
    centred_old, centred_new = old - old.mean(axis=0), new - new.mean(axis=0)
    size = float((centred_old**2).sum())
    scale = float((centred_old * centred_new).sum()) / size if size > 0 else 1.0
    shift = new.mean(axis=0) - scale * old.mean(axis=0)
    moved = {}
    for name, camera in cameras.items():
        rotation = camera.rotation @ R_new_old.T
        centre = scale * R_new_old @ camera.centre + shift
        moved[name] = replace(camera, rotation=rotation, translation=-rotation @ centre)
    return moved


def _board_poses(cameras: Mapping[str, Camera], pictures: Mapping[str, Picture], board: Board) -> dict[str, Camera]:
    poses, last_error = {}, None
    for name, camera in cameras.items():
        try:
            poses[name] = board_pose(pictures[name], camera, board)
        except UserError as error:
            last_error = error
    if not poses:
        assert last_error is not None
        raise last_error
    return poses
