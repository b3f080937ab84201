"""The unknowns of a rig's calibration, the observed corners, and the projection with its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.board_calibration.detection import BoardView
from fourd.boards import CalibrationBoard
from fourd.cameras import Camera

Array = NDArray[np.float64]

POSE, LENS = slice(0, 6), slice(6, 15)
"""Indices of a camera's pose (rotation, translation) and lens (fx, fy, cx, cy, k1, k2, p1, p2, k3) in the vector of its
parameters."""
PARAMETERS = 15
"""Number of parameters per camera."""
BOARD_PARAMETERS = 6
"""Number of parameters per position of the board: rotation, translation."""
MIN_DEPTH = 1e-6


@dataclass(frozen=True, eq=False)
class Corners:
    """N observed corners of a board.

    Attributes:
        camera: (N,) indices of the cameras.
        board: (N,) indices of the board's positions.
        xyz: (N, 3) corners in board coordinates, in metres.
        pixels: (N, 2) observations in the distorted images.
    """

    camera: NDArray[np.intp]
    board: NDArray[np.intp]
    xyz: Array
    pixels: Array

    def select(self, kept: NDArray[np.bool_]) -> Corners:
        """The corners in a mask (N,)."""
        return Corners(self.camera[kept], self.board[kept], self.xyz[kept], self.pixels[kept])


@dataclass(frozen=True, eq=False)
class Poses:
    """M rigid motions x -> R x + t.

    Attributes:
        rotation: (M, 3, 3) matrices R.
        translation: (M, 3) vectors t in metres.
    """

    rotation: Array
    translation: Array

    def __len__(self) -> int:
        return len(self.rotation)

    def __getitem__(self, which: slice | int | NDArray[np.intp] | Sequence[int]) -> Poses:
        index = slice(which, which + 1) if isinstance(which, int) else which
        return Poses(self.rotation[index], self.translation[index])

    def after(self, first: Poses) -> Poses:
        """The motions that apply ``first`` and then these."""
        return Poses(
            self.rotation @ first.rotation,
            (self.rotation @ first.translation[..., None])[..., 0] + self.translation,
        )

    def inverse(self) -> Poses:
        """The inverse motions."""
        back = np.swapaxes(self.rotation, 1, 2)
        return Poses(back, -(back @ self.translation[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class RigState:
    """Cameras and positions of the board.

    Attributes:
        cameras: C cameras with poses from world to camera.
        boards: F poses from board to world.
    """

    cameras: tuple[Camera, ...]
    boards: Poses

    @property
    def camera_poses(self) -> Poses:
        """C poses from world to camera."""
        return Poses(
            np.stack([camera.rotation for camera in self.cameras]),
            np.stack([camera.translation for camera in self.cameras]),
        )


@dataclass(frozen=True, eq=False)
class Projection:
    """Projections of N corners.

    Attributes:
        pixels: (N, 2) projections with lens distortion.
        depth: (N,) depths in metres.
        by_camera: (N, 2, 15) derivatives with respect to the parameters of each corner's camera.
        by_board: (N, 2, 6) derivatives with respect to the pose of each corner's board.
    """

    pixels: Array
    depth: Array
    by_camera: Array
    by_board: Array


def collect_corners(board: CalibrationBoard, views: Sequence[BoardView], frames: Sequence[int]) -> Corners:
    """Collect the corners of the views in ``frames``. The index of a board's position is the index of its frame."""
    index = {frame: number for number, frame in enumerate(frames)}
    used = [view for view in views if view.frame in index]
    counts = [len(view.corners) for view in used]
    return Corners(
        np.repeat(np.array([view.camera for view in used], np.intp), counts),
        np.repeat(np.array([index[view.frame] for view in used], np.intp), counts),
        np.concatenate([board.corners[view.corners] for view in used] or [np.zeros((0, 3))]),
        np.concatenate([view.pixels for view in used] or [np.zeros((0, 2))]),
    )


def project(state: RigState, corners: Corners) -> Projection:
    """Project corners, with derivatives.

    A rotation's parameters are a rotation vector w that is applied from the left: R -> exp([w]x) R. Depths below 1e-6 m
    are replaced by 1e-6 m before the division.
    """
    count = len(corners.camera)
    on_board = (state.boards.rotation[corners.board] @ corners.xyz[..., None])[..., 0]
    world = on_board + state.boards.translation[corners.board]
    poses = state.camera_poses
    turn = poses.rotation[corners.camera]
    turned = (turn @ world[..., None])[..., 0]
    in_camera = turned + poses.translation[corners.camera]
    safe = in_camera.copy()
    safe[:, 2] = np.maximum(in_camera[:, 2], MIN_DEPTH)
    pixels, by_point, by_camera = np.zeros((count, 2)), np.zeros((count, 2, 3)), np.zeros((count, 2, PARAMETERS))
    for index, camera in enumerate(state.cameras):
        rows = np.flatnonzero(corners.camera == index)
        if not len(rows):
            continue
        distortion = np.zeros(5) if camera.distortion is None else camera.distortion
        found, jacobian = cv2.projectPoints(safe[rows], np.zeros(3), np.zeros(3), camera.intrinsics, distortion)
        jacobian = np.asarray(jacobian).reshape(len(rows), 2, -1)
        pixels[rows] = np.asarray(found).reshape(-1, 2)
        by_point[rows] = jacobian[..., 3:6]
        lens = jacobian[..., 6:15]
        by_camera[rows, :, LENS.start : LENS.start + lens.shape[-1]] = lens
    # The derivative of exp([w]x) p with respect to w at w = 0 is -[p]x.
    by_camera[..., :3] = by_point @ -_cross_matrices(turned)
    by_camera[..., 3:6] = by_point
    by_world = by_point @ turn
    by_board = np.concatenate([by_world @ -_cross_matrices(on_board), by_world], axis=2)
    return Projection(pixels, in_camera[:, 2], by_camera, by_board)


def reprojection_errors(state: RigState, corners: Corners) -> Array:
    """Distances (N,) in pixels between projections and observations. They are infinite behind the camera."""
    found = project(state, corners)
    return np.where(found.depth > MIN_DEPTH, np.linalg.norm(found.pixels - corners.pixels, axis=1), np.inf)


def lens_vector(camera: Camera) -> Array:
    """A camera's lens as (9,) fx, fy, cx, cy, k1, k2, p1, p2, k3. Further coefficients are left out."""
    k, distortion = camera.intrinsics, np.zeros(5)
    if camera.distortion is not None:
        distortion[: min(5, len(camera.distortion))] = camera.distortion[:5]
    return np.concatenate([[k[0, 0], k[1, 1], k[0, 2], k[1, 2]], distortion])


def _cross_matrices(vectors: Array) -> Array:
    """Matrices (N, 3, 3) of the cross product from the left with each vector (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], axis=1)
