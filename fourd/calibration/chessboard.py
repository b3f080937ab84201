"""A camera's pose with respect to a chessboard in its picture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.errors import UserError

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

MIN_CORNERS = 3


@dataclass(frozen=True)
class Board:
    """A chessboard: its numbers of inner corners along the two sides, and the side of a square in metres."""

    columns: int
    rows: int
    square_m: float


def board_pose(picture: Picture, camera: Camera, board: Board) -> Camera:
    """The camera with its pose relative to a chessboard, in metres.

    The origin is an inner corner at the end of the board; x runs along the ``columns`` corners, y along the ``rows``
    corners, z off the board towards the camera, and the square at x, y > 0 is black. For odd ``columns + rows`` this
    is the same corner from all viewpoints. For even sums the board looks the same rotated by 180 degrees, and the
    origin is either of two corners.

    Args:
        picture: RGB (H, W, 3) uint8, distorted.
        camera: intrinsics and distortion; its pose is not used.
        board: at least 3 inner corners along each side.

    Raises:
        UserError: for numbers out of range, and when the whole board is not visible.
    """
    columns, rows, square_m = board.columns, board.rows, board.square_m
    if min(columns, rows) < MIN_CORNERS or not (np.isfinite(square_m) and square_m > 0):
        raise UserError(
            f"board: expected at least {MIN_CORNERS} x {MIN_CORNERS} inner corners and a side above 0 m, got "
            f"{columns} x {rows} and {square_m:g} m; count where four squares meet"
        )
    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)
    pixels = _detect_corners(grey, columns, rows)
    j, i = np.meshgrid(np.arange(columns), np.arange(rows))
    xyz = square_m * np.stack([j, i, np.zeros_like(i)], axis=-1).reshape(-1, 3)
    # OpenCV's pixel coordinates are 0 at the first pixel's centre.
    xy = pixels.reshape(-1, 2) + 0.5
    _, rvec, tvec = cv2.solvePnP(xyz, xy, camera.intrinsics, camera.distortion, flags=cv2.SOLVEPNP_IPPE)
    rvec, tvec = cv2.solvePnPRefineLM(xyz, xy, camera.intrinsics, camera.distortion, rvec, tvec)
    rotation = np.asarray(cv2.Rodrigues(rvec)[0], np.float64)
    return replace(camera, rotation=rotation, translation=np.asarray(tvec, np.float64).ravel())


def _detect_corners(grey: Picture, columns: int, rows: int) -> Array:
    """(rows, columns, 2) inner corners in OpenCV's pixel coordinates, in the order that board_pose defines."""
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=flags)
    if not found:
        raise UserError(
            f"board: expected a chessboard of {columns} x {rows} inner corners, got none in the picture; show all "
            "of it with a white margin, flat, sharp and without glare"
        )
    pixels = corners.reshape(rows, columns, 2).astype(np.float64)
    along, across = pixels[0, -1] - pixels[0, 0], pixels[-1, 0] - pixels[0, 0]
    if along[0] * across[1] - along[1] * across[0] > 0:
        # x to y turns counterclockwise seen from +z; in a picture, whose y is down, the cross product is negative.
        pixels = pixels[::-1]
    if _is_first_square_bright(grey, pixels):
        pixels = pixels[::-1, ::-1]
    return pixels


def _is_first_square_bright(grey: Picture, corners: Array) -> bool:
    """Whether the square between the first four corners (rows, columns, 2) is brighter than its neighbour."""
    values = [
        float(
            cv2.getRectSubPix(grey, (3, 3), tuple(map(float, corners[:2, left : right + 1].mean(axis=(0, 1))))).mean()
        )
        for left, right in pairwise(range(3))
    ]
    return values[0] > values[1]
