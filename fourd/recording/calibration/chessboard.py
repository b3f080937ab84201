"""Pose of a camera relative to a chessboard in its image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.boards import side_problem

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

MIN_CORNERS = 3


@dataclass(frozen=True)
class Board:
    """A chessboard.

    Attributes:
        columns: number of inner corners along one side.
        rows: number of inner corners along the other side.
        square_m: side of a square in metres.
    """

    columns: int
    rows: int
    square_m: float


def board_pose(picture: Picture, camera: Camera, board: Board) -> Camera:
    """Return the camera with its pose relative to a chessboard, in metres.

    The origin is at one of the four outermost inner corners. The x axis points along the side with ``columns`` inner
    corners, the y axis along the side with ``rows`` inner corners, and the z axis from the board towards the camera.
    If ``columns + rows`` is odd, the square that touches the origin on the +x and +y side is black, so the origin is
    the same in all views. If ``columns + rows`` is even, the square can have either colour. The board then looks the
    same after a rotation by 180 degrees, so the origin may be at either of two opposite corners. If ``columns`` and
    ``rows`` are equal, it may be at any of the four corners.

    Args:
        picture: distorted RGB image (H, W, 3) uint8.
        camera: intrinsics and distortion; its pose is ignored.
        board: chessboard with at least 3 inner corners along each side.

    Raises:
        UserError: if an attribute of ``board`` is out of range, or a part of the board is not visible.
    """
    columns, rows, square_m = board.columns, board.rows, board.square_m
    if min(columns, rows) < MIN_CORNERS or not (np.isfinite(square_m) and square_m > 0):
        raise UserError(
            f"board: expected at least {MIN_CORNERS} x {MIN_CORNERS} inner corners and squares above 0 m, got "
            f"{columns} x {rows} and {square_m:g} m; count the points where four squares meet"
        )
    problem = side_problem(square_m)
    if problem is not None:
        raise UserError(f"board: {problem}")
    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)
    pixels = find_corners(grey, columns, rows)
    if pixels is None:
        raise UserError(
            f"board: expected a chessboard of {columns} x {rows} inner corners, got none in the image; take an image "
            "of the whole flat board with a white margin, in focus and without glare"
        )
    j, i = np.meshgrid(np.arange(columns), np.arange(rows))
    xyz = square_m * np.stack([j, i, np.zeros_like(i)], axis=-1).reshape(-1, 3)
    # The centre of the first pixel has the coordinate 0 in OpenCV and 0.5 in fourd.
    xy = pixels.reshape(-1, 2) + 0.5
    _, rvec, tvec = cv2.solvePnP(xyz, xy, camera.intrinsics, camera.distortion, flags=cv2.SOLVEPNP_IPPE)
    rvec, tvec = cv2.solvePnPRefineLM(xyz, xy, camera.intrinsics, camera.distortion, rvec, tvec)
    rotation = np.asarray(cv2.Rodrigues(rvec)[0], np.float64)
    return replace(camera, rotation=rotation, translation=np.asarray(tvec, np.float64).ravel())


def find_corners(grey: Picture, columns: int, rows: int) -> Array | None:
    """Detect the inner corners (rows, columns, 2) in OpenCV's pixel coordinates.

    The first corner is the origin described in :func:`board_pose`. The corners of a row follow each other along the
    x axis, and the rows follow each other along the y axis. Returns None if the image does not show all inner corners.
    """
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=flags)
    if not found:
        return None
    pixels = corners.reshape(rows, columns, 2).astype(np.float64)
    along, across = pixels[0, -1] - pixels[0, 0], pixels[-1, 0] - pixels[0, 0]
    if along[0] * across[1] - along[1] * across[0] > 0:
        # Seen from +z, the board's y axis is counterclockwise from its x axis. Because the image's y axis points down,
        # the cross product of the board's axes must be negative in the image. A positive cross product means that the
        # rows are in the wrong order.
        pixels = pixels[::-1]
    if _is_first_square_bright(grey, pixels):
        pixels = pixels[::-1, ::-1]
    return pixels


def _is_first_square_bright(grey: Picture, corners: Array) -> bool:
    """Return whether the first square is brighter than the next square along x.

    ``corners`` has shape (rows, columns, 2). The first square is the one between the first two rows and the first two
    columns of corners.
    """
    values = [
        float(
            cv2.getRectSubPix(grey, (3, 3), tuple(map(float, corners[:2, left : right + 1].mean(axis=(0, 1))))).mean()
        )
        for left, right in pairwise(range(3))
    ]
    return values[0] > values[1]
