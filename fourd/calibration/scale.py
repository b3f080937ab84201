"""Cameras of an import that have no calibration, and the unit, origin and axes that somebody measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.calibration.structure_from_motion import board_pose, calibrate, placed, scaled
from fourd.cameras import Camera
from fourd.errors import UserError

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Distance:
    """Metres between the centres of two cameras."""

    first: str
    second: str
    metres: float


@dataclass(frozen=True)
class Board:
    """A chessboard's inner corners along both sides, and the side of a square in metres."""

    columns: int
    rows: int
    square_m: float


def calibrated(pictures: Mapping[str, Picture]) -> tuple[dict[str, Camera], str]:
    """Cameras from one picture of each, and what to say of them. Raises UserError as calibrate does."""
    found = calibrate({name: [picture] for name, picture in pictures.items()})
    return found.cameras, (
        f"calibrated from the pictures: {len(found.cameras)} cameras, {found.points} points, "
        f"{found.error_px:.2f} px reprojection error"
    )


def gauged(
    cameras: Mapping[str, Camera], pictures: Mapping[str, Picture], distance: Distance | None, board: Board | None
) -> tuple[dict[str, Camera], list[str]]:
    """The cameras in the unit of ``distance`` and in the world of ``board``, where these are given, and notes.

    Args:
        cameras: by name, for the pictures as they are.
        pictures: by the same names, an RGB picture (H, W, 3) of each; those that show the board place the world.

    Raises:
        UserError: for a camera that is none, a distance not above 0, or a board that no picture shows.
    """
    moved, notes = dict(cameras), []
    if distance is not None:
        moved = scaled(moved, (distance.first, distance.second), distance.metres)
        notes.append(f"scaled: {distance.first} and {distance.second} are {distance.metres:g} m apart")
    if board is not None:
        poses = _poses(moved, pictures, board)
        moved = placed(moved, poses)
        notes.append(
            f"placed by the chessboard that {', '.join(poses)} show: its corner is the origin, z off the board"
        )
        if len(poses) == 1 and distance is None:
            notes.append("one camera's view of the board gives no unit; give --scale, or show it to two cameras")
    return moved, notes


def _poses(cameras: Mapping[str, Camera], pictures: Mapping[str, Picture], board: Board) -> dict[str, Camera]:
    poses, last = {}, None
    for name, lens in cameras.items():
        try:
            poses[name] = board_pose(pictures[name], lens, board.columns, board.rows, board.square_m)
        except UserError as error:
            last = error
    if not poses:
        assert last is not None
        raise last
    return poses
