"""Bundle adjustment of a rig and the positions of a board.

The solver is the Levenberg-Marquardt algorithm with a Huber loss by iteratively reweighted least squares. The poses of
the board are eliminated by the Schur complement (Triggs et al., Bundle Adjustment - a Modern Synthesis, 2000, sec.
6.1), so that the time grows linearly with the number of frames. The inverse of the reduced normal equations is the
covariance of the cameras' parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from fourd.board_calibration.rig import (
    BOARD_PARAMETERS,
    LENS,
    MIN_DEPTH,
    PARAMETERS,
    POSE,
    Corners,
    Poses,
    RigState,
    lens_vector,
    project,
)
from fourd.cameras import Camera

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_STEPS = 60
MAX_TRIALS = 8
DAMPING = 1e-3
"""Initial damping factor of the Levenberg-Marquardt algorithm."""
MIN_RELATIVE_DECREASE = 1e-7
"""The solver stops when a step decreases the cost by less than this fraction of the cost."""
PRIOR_ASPECT = 0.005
"""Standard deviation of the logarithm of fx / fy around 0: pixels are square."""
PRIOR_CENTRE = 0.015
"""Standard deviation of the principal point around the image's centre, as a share of the image's longer side."""
PRIOR_DISTORTION = np.array([0.3, 0.3, 0.002, 0.002, 0.3])
"""Standard deviations of k1, k2, p1, p2 and k3 around 0. The prior matters where corners cover a small part of the
image or few directions of the board, which leaves combinations of coefficients undetermined."""


@dataclass(frozen=True, eq=False)
class Loss:
    """Weights of the terms of the cost.

    Attributes:
        scale_px: scale of the Huber loss in pixels.
        corner_px: (C,) standard deviation of a corner's position in each camera, in pixels, that weighs the corners
            against the prior.
    """

    scale_px: float
    corner_px: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of an adjustment.

    Attributes:
        state: the adjusted rig.
        std: (C, 15) standard deviations of the cameras' parameters, in radians, metres, pixels and 1. They are 0 for
            fixed parameters.
    """

    state: RigState
    std: Array


def solve_rig(start: RigState, corners: Corners, free: Mask, loss: Loss) -> Solution:
    """Minimise the Huber loss of the reprojection errors, with a weak prior on the lenses that are free.

    Args:
        start: initial rig, with the corners in front of the cameras.
        corners: observations.
        free: (C, 15) parameters that are adjusted. One camera's pose should be fixed, because turning all cameras and
            boards together would not change the cost.
        loss: scale of the Huber loss, and weight of the prior.
    """
    state, damping = start, DAMPING
    cost = _cost(state, corners, free, loss)
    for _ in range(MAX_STEPS):
        system = _linearize(state, corners, free, loss)
        gain = 0.0
        for _ in range(MAX_TRIALS):
            trial = _move(state, *system.step(damping))
            after = _cost(trial, corners, free, loss)
            if after < cost:
                gain = (cost - after) / max(cost, 1e-300)
                state, cost, damping = trial, after, max(damping / 10, 1e-10)
                break
            damping *= 10
        if gain < MIN_RELATIVE_DECREASE:
            break
    return Solution(state, _standard_deviations(state, corners, free, loss))


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations of C cameras and F boards.

    Attributes:
        cameras: (C, 15, 15) diagonal blocks of the cameras, the identity for fixed parameters.
        boards: (F, 6, 6) diagonal blocks of the boards.
        coupling: (F, 15 C, 6) blocks between each board and all cameras.
        rhs_cameras: (C, 15) right-hand side.
        rhs_boards: (F, 6) right-hand side.
    """

    cameras: Array
    boards: Array
    coupling: Array
    rhs_cameras: Array
    rhs_boards: Array

    def step(self, damping: float) -> tuple[Array, Array]:
        """Steps of the cameras (C, 15) and of the boards (F, 6). Diagonals are multiplied by 1 + ``damping``."""
        reduced, eliminated = self.reduce(damping)
        rhs = self.rhs_cameras.ravel() - np.einsum("fij,fj->i", eliminated, self.rhs_boards)
        step = np.linalg.solve(reduced, rhs)
        inverse = np.linalg.inv(_damped(self.boards, damping))
        rest = self.rhs_boards - np.einsum("fij,i->fj", self.coupling, step)
        return step.reshape(-1, PARAMETERS), np.einsum("fij,fj->fi", inverse, rest)

    def reduce(self, damping: float) -> tuple[Array, Array]:
        """Reduced normal equations (15 C, 15 C) of the cameras, and coupling times inverse blocks (F, 15 C, 6)."""
        count = len(self.cameras)
        eliminated = self.coupling @ np.linalg.inv(_damped(self.boards, damping))
        whole = np.zeros((count, PARAMETERS, count, PARAMETERS))
        whole[np.arange(count), :, np.arange(count)] = _damped(self.cameras, damping)
        size = count * PARAMETERS
        left = np.swapaxes(eliminated, 0, 1).reshape(size, -1)
        right = np.swapaxes(self.coupling, 0, 1).reshape(size, -1)
        return whole.reshape(size, size) - left @ right.T, eliminated


def _linearize(state: RigState, corners: Corners, free: Mask, loss: Loss) -> _System:
    """Build the normal equations at ``state``."""
    count, boards = len(state.cameras), len(state.boards)
    found = project(state, corners)
    residual = found.pixels - corners.pixels
    weight = _weights(residual, loss.scale_px)[:, None, None]
    by_camera = found.by_camera * free[corners.camera][:, None]
    weighted_camera, weighted_board = by_camera * weight, found.by_board * weight
    camera_blocks = np.zeros((count, PARAMETERS, PARAMETERS))
    rhs_cameras = np.zeros((count, PARAMETERS))
    for index in range(count):
        rows = corners.camera == index
        flat = weighted_camera[rows].reshape(-1, PARAMETERS)
        camera_blocks[index] = flat.T @ by_camera[rows].reshape(-1, PARAMETERS)
        rhs_cameras[index] = -flat.T @ residual[rows].ravel()
    board_blocks = np.zeros((boards, BOARD_PARAMETERS, BOARD_PARAMETERS))
    np.add.at(board_blocks, corners.board, np.swapaxes(weighted_board, 1, 2) @ found.by_board)
    rhs_boards = np.zeros((boards, BOARD_PARAMETERS))
    np.add.at(rhs_boards, corners.board, -np.einsum("nij,ni->nj", weighted_board, residual))
    coupling = np.zeros((boards, count, PARAMETERS, BOARD_PARAMETERS))
    np.add.at(coupling, (corners.board, corners.camera), np.swapaxes(weighted_camera, 1, 2) @ found.by_board)
    precision, offset = _prior(state, free, loss.corner_px)
    camera_blocks += precision + ~free[:, :, None] * np.eye(PARAMETERS)
    rhs_cameras -= np.einsum("cij,cj->ci", precision, offset)
    # A board without observations would make its block singular.
    board_blocks += 1e-9 * np.eye(BOARD_PARAMETERS)
    return _System(camera_blocks, board_blocks, coupling.reshape(boards, -1, BOARD_PARAMETERS), rhs_cameras, rhs_boards)


def _cost(state: RigState, corners: Corners, free: Mask, loss: Loss) -> float:
    found = project(state, corners)
    if (found.depth < MIN_DEPTH).any():
        return float("inf")
    error = np.linalg.norm(found.pixels - corners.pixels, axis=1)
    scale_px = loss.scale_px
    huber = np.where(error <= scale_px, error**2, 2 * scale_px * error - scale_px**2)
    precision, offset = _prior(state, free, loss.corner_px)
    return float(huber.sum() + np.einsum("ci,cij,cj->", offset, precision, offset))


def _weights(residual: Array, scale_px: float) -> Array:
    """Weights (N,) of the Huber loss."""
    error = np.linalg.norm(residual, axis=1)
    return np.where(error <= scale_px, 1.0, scale_px / np.maximum(error, scale_px))


def _prior(state: RigState, free: Mask, corner_px: Array) -> tuple[Array, Array]:
    """Precision (C, 15, 15) of the prior in units of the cost, and distances (C, 15) from the prior's mean."""
    count = len(state.cameras)
    precision, offset = np.zeros((count, PARAMETERS, PARAMETERS)), np.zeros((count, PARAMETERS))
    for index, camera in enumerate(state.cameras):
        if not free[index, LENS].all():
            continue
        lens = lens_vector(camera)
        # The distance from square pixels is (fx - fy) / f, which is linear in fx and fy.
        aspect = np.zeros(PARAMETERS)
        aspect[LENS][:2] = np.array([1, -1]) / (PRIOR_ASPECT * lens[:2].mean())
        centre = PRIOR_CENTRE * max(camera.width, camera.height)
        diagonal = np.zeros(PARAMETERS)
        diagonal[LENS][2:] = 1 / np.concatenate([[centre, centre], PRIOR_DISTORTION]) ** 2
        precision[index] = corner_px[index] ** 2 * (np.diag(diagonal) + np.outer(aspect, aspect))
        offset[index, LENS] = lens
        offset[index, LENS][2:4] -= (camera.width / 2, camera.height / 2)
    return precision, offset


def _standard_deviations(state: RigState, corners: Corners, free: Mask, loss: Loss) -> Array:
    """Standard deviations (C, 15) of the cameras' parameters.

    The covariance is H^-1 G H^-1, where H are the reduced normal equations and G is the sum over the frames of the
    squared gradients (the sandwich estimate with clusters, Liang and Zeger 1986), and of the prior. It allows for
    errors that are correlated within a frame, for example because the board moved between the exposures of two
    cameras.
    """
    system = _linearize(state, corners, free, loss)
    reduced, eliminated = system.reduce(0.0)
    # Scaling to a unit diagonal keeps parameters of different units comparable.
    scale = 1 / np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    inverse = np.linalg.pinv(reduced * np.outer(scale, scale), rcond=1e-14, hermitian=True) * np.outer(scale, scale)
    found = project(state, corners)
    residual = found.pixels - corners.pixels
    weighted = _weights(residual, loss.scale_px)[:, None] * residual
    gradients = np.zeros((len(state.boards), len(state.cameras), PARAMETERS))
    by_camera = found.by_camera * free[corners.camera][:, None]
    np.add.at(gradients, (corners.board, corners.camera), np.einsum("nij,ni->nj", by_camera, weighted))
    by_board = np.zeros((len(state.boards), BOARD_PARAMETERS))
    np.add.at(by_board, corners.board, np.einsum("nij,ni->nj", found.by_board, weighted))
    scores = gradients.reshape(len(gradients), -1) - np.einsum("fij,fj->fi", eliminated, by_board)
    # The mean of the prior is as uncertain as the prior says, which adds to the gradients' variance.
    precision, _ = _prior(state, free, loss.corner_px)
    variance = scores.T @ scores + block_diag(*(loss.corner_px[:, None, None] ** 2 * precision))
    covariance = inverse @ variance @ inverse
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0)).reshape(free.shape) * free, np.float64)


def _damped(blocks: Array, damping: float) -> Array:
    return blocks * (1 + damping * np.eye(blocks.shape[-1]))


def _move(state: RigState, cameras: Array, boards: Array) -> RigState:
    """Apply the steps of the cameras (C, 15) and of the boards (F, 6)."""
    turns = np.stack([cv2.Rodrigues(step[:3])[0] for step in boards]) if len(boards) else np.zeros((0, 3, 3))
    moved = Poses(turns @ state.boards.rotation, state.boards.translation + boards[:, 3:])
    return RigState(tuple(map(_move_camera, state.cameras, cameras)), moved)


def _move_camera(camera: Camera, step: Array) -> Camera:
    rotation = cv2.Rodrigues(step[POSE][:3])[0] @ camera.rotation
    translation = camera.translation + step[POSE][3:]
    if not step[LENS].any():
        return replace(camera, rotation=rotation, translation=translation)
    fx, fy, cx, cy, *distortion = lens_vector(camera) + step[LENS]
    intrinsics = np.array([[max(fx, 1.0), 0, cx], [0, max(fy, 1.0), cy], [0, 0, 1]])
    return replace(
        camera, intrinsics=intrinsics, rotation=rotation, translation=translation, distortion=np.array(distortion)
    )
