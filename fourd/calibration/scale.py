"""Scale, origin and axes of calibrated cameras, from a measured distance or from known poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.calibration.chessboard import Board, board_pose
from fourd.cameras import Camera
from fourd.errors import UserError

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Distance:
    """Distance between the centres of two cameras in metres."""

    first: str
    second: str
    metres: float


def set_world_frame(
    cameras: Mapping[str, Camera], pictures: Mapping[str, Picture], distance: Distance | None, board: Board | None
) -> tuple[dict[str, Camera], list[str]]:
    """The cameras in the unit of ``distance`` and the world of ``board``, where these are given, and notes.

    Args:
        cameras: by name, with the distortion of the pictures.
        pictures: by the same names an RGB picture (H, W, 3) of each; those that show the board define the world.
        distance: known distance between two cameras.
        board: chessboard in the pictures.

    Raises:
        UserError: for a name without a camera, a distance that is not positive, or a board that no picture shows.
    """
    moved, notes = dict(cameras), []
    if distance is not None:
        moved = scale_cameras(moved, distance)
        notes.append(f"scaled: {distance.first} and {distance.second} are {distance.metres:g} m apart")
    if board is not None:
        poses = _board_poses(moved, pictures, board)
        moved = align_cameras(moved, poses)
        notes.append(
            f"aligned to the chessboard in the pictures of {', '.join(poses)}: origin at its corner, z off the board"
        )
        if len(poses) == 1 and distance is None:
            notes.append("one camera's view of the board gives no unit; give --scale, or show it to two cameras")
    return moved, notes


def scale_cameras(cameras: Mapping[str, Camera], distance: Distance) -> dict[str, Camera]:
    """The cameras in metres, scaled so that the two cameras of ``distance`` have that distance.

    Raises:
        UserError: for a name without a camera, twice the same camera, or a distance that is not positive.
    """
    names = (distance.first, distance.second)
    for name in names:
        if name not in cameras:
            raise UserError(f"{name}: expected one of {', '.join(cameras)}, got another name; name a calibrated camera")
    first, second = (cameras[name].centre for name in names)
    length = float(np.linalg.norm(first - second))
    if not (np.isfinite(distance.metres) and distance.metres > 0 and length > 0):
        raise UserError(
            f"{names[0]}, {names[1]}: expected two cameras apart and their distance above 0, got {distance.metres:g}; "
            "measure between the centres of their lenses"
        )
    return {
        name: replace(camera, translation=camera.translation * distance.metres / length)
        for name, camera in cameras.items()
    }


def align_cameras(cameras: Mapping[str, Camera], poses: Mapping[str, Camera]) -> dict[str, Camera]:
    """All cameras, transformed into the world in which some of them have the given ``poses``.

    One pose gives rotation and translation and keeps the scale. Two poses or more give the scale too: the rotation is
    the mean of theirs; scale and translation fit their centres in the least-squares sense.

    Raises:
        UserError: when no pose is of one of the cameras.
    """
    known = [name for name in poses if name in cameras]
    if not known:
        raise UserError("board: expected it in the picture of a calibrated camera, got none; show it to one of them")
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
