"""Noise model of detected corners. Each corner has an independent error, and all corners of one image share further
errors.

The corners of one image share errors because of a bent board, motion blur, or an exposure that does not start exactly
at the frame's time. The shared errors are described as a small random rotation, shift and delay of the board in each
view (one camera's image of the board). The variances of the shared errors are estimated together with the rig by
expectation maximisation (Dempster, Laird and Rubin 1977; Harville, Maximum likelihood approaches to variance component
estimation, 1977).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.recording.board_calibration.adjustment.rig import (
    BOARD_PARAMETERS,
    Corners,
    Projection,
    RigState,
    cross_matrices,
)

Array = NDArray[np.float64]

SHARED = 7
"""Number of error components that all corners of a view share: rotation (3), shift (3), delay (1)."""
TURN, SHIFT, JITTER = slice(0, 3), slice(3, 6), slice(6, 7)
HUBER_VIEW = 0.7
"""A view has full weight if the root mean square of its shared errors, in standard deviations, is at most this value.
Larger errors are down-weighted, because the shared errors have heavy tails: some images are blurred more than
others."""
SWEEPS = 4
"""Number of steps of the expectation maximisation per call."""
MIN_CORNER_PX = 0.01


@dataclass(frozen=True, eq=False)
class ViewNoise:
    """Standard deviations of the errors of corners: the independent error of each corner, and the rotation, shift and
    delay of the board that all corners of a view share.

    Attributes:
        corner_px: (C,) standard deviation, in pixels, of the independent errors of each camera's corners along x and y.
        turn: standard deviation of the shared rotation about each axis through the middle of the board, in radians.
        shift_m: standard deviation of the shared shift along each axis, in metres.
        jitter: standard deviation of the shared delay, in frames.
    """

    corner_px: Array
    turn: float = 0.0
    shift_m: float = 0.0
    jitter: float = 0.0

    @property
    def shared_std(self) -> Array:
        """(7,) standard deviations of the shared errors."""
        return np.array([self.turn] * 3 + [self.shift_m] * 3 + [self.jitter])


@dataclass(frozen=True, eq=False)
class Views:
    """N corners, grouped by view.

    Attributes:
        index: (N,) index of each corner's view.
        camera: (V,) index of each view's camera.
        board: (V,) index of the board's pose in each view.
        rows: (V, M) indices of the corners of each view. M is the largest number of corners of a view. Unused elements
            are N.
    """

    index: NDArray[np.intp]
    camera: NDArray[np.intp]
    board: NDArray[np.intp]
    rows: NDArray[np.intp]

    def pad(self, values: Array, which: slice = slice(None)) -> Array:
        """Arrange values (N, 2, Q) of the corners by view: (V, 2 * M, Q) for the views ``which``, padded with zeros."""
        padded = np.concatenate([values, np.zeros((1, *values.shape[1:]))])[self.rows[which]]
        return padded.reshape(len(padded), -1, values.shape[2])


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of a robust least-squares fit.

    Attributes:
        corner: (N,) weights of the corners.
        view: (V,) weights of the views' shared errors.
    """

    corner: Array
    view: Array


def group_views(corners: Corners) -> Views:
    """Group corners by camera and position of the board."""
    boards = int(corners.board.max(initial=0)) + 1
    keys, index, counts = np.unique(corners.camera * boards + corners.board, return_inverse=True, return_counts=True)
    order = np.argsort(index, kind="stable")
    rows = np.full((len(keys), counts.max(initial=0)), len(index), np.intp)
    starts = np.cumsum(counts) - counts
    rows[index[order], np.arange(len(index)) - starts[index[order]]] = order
    return Views(index, keys // boards, keys % boards, rows)


def shared_derivatives(state: RigState, corners: Corners, found: Projection) -> Array:
    """Return the derivatives (N, 2, 7) of the pixels with respect to the shared errors of their view."""
    middle = (corners.xyz.min(axis=0) + corners.xyz.max(axis=0)) / 2
    arm = state.boards.rotation[corners.board] @ middle
    by_turn, by_shift = found.by_board[..., :3], found.by_board[..., 3:]
    # A rotation R about the board's middle m equals the rotation R about the board's origin plus the shift m - R @ m.
    return np.concatenate([by_turn + by_shift @ cross_matrices(arm), by_shift, found.by_time[..., None]], axis=2)


def weigh(
    views: Views, residual: Array, shared: Array, noise: ViewNoise, camera: NDArray[np.intp], huber_px: Array
) -> Weights:
    """Compute the weights of the corners and of the views' shared errors. A corner's weight is the weight that the
    Huber loss gives to its error, after the shared errors of its view are subtracted.

    Args:
        views: the corners by view.
        residual: (N, 2) residuals in pixels.
        shared: (N, 2, 7) derivatives with respect to the shared errors.
        noise: standard deviations.
        camera: (N,) camera of each corner.
        huber_px: (C,) scale of the Huber loss in pixels.
    """
    std = noise.shared_std
    weights = Weights(np.ones(len(residual)), np.ones(len(views.camera)))
    for _ in range(3 if std.any() else 1):
        rest = residual
        if std.any():
            scale = np.sqrt(weights.corner) / noise.corner_px[camera]
            left = views.pad(shared * std * scale[:, None, None])
            right = views.pad((residual * scale[:, None])[..., None])
            gram = np.swapaxes(left, 1, 2) @ left + np.eye(SHARED) * weights.view[:, None, None]
            latent = np.linalg.solve(gram, np.swapaxes(left, 1, 2) @ right)[..., 0]
            rest = residual - np.einsum("nij,nj->ni", shared * std, latent[views.index])
            size = np.sqrt(np.mean(latent**2, axis=1))
            weights = replace(weights, view=np.minimum(1.0, HUBER_VIEW / np.maximum(size, 1e-9)))
        error = np.linalg.norm(rest, axis=1)
        limit = huber_px[camera]
        weights = replace(weights, corner=np.where(error <= limit, 1.0, limit / np.maximum(error, limit)))
    return weights


def estimate_noise(
    state: RigState,
    corners: Corners,
    found: Projection,
    views: Views,
    noise: ViewNoise,
    weights: Weights,
    floor: ViewNoise,
) -> ViewNoise:
    """Re-estimate the standard deviations for the current state of the rig.

    The independent errors are the residuals after fitting a separate pose of the board to each view. The shared errors
    are estimated together with the pose of the board, from frames in which two or more cameras see the board. Their
    standard deviations are at least those in ``floor``.
    """
    residual = corners.pixels - found.pixels
    shared = shared_derivatives(state, corners, found)
    columns = np.concatenate([found.by_board, shared, residual[..., None]], axis=2)
    padded = views.pad(columns * np.sqrt(weights.corner)[:, None, None])
    grams = np.swapaxes(padded, 1, 2) @ padded
    noise = replace(noise, corner_px=_independent(views, grams, noise.corner_px))
    grams = grams / noise.corner_px[views.camera][:, None, None] ** 2
    for _ in range(SWEEPS):
        factor = np.sqrt(np.maximum(_mean_squares(views, grams, noise, weights), 1e-12))
        noise = replace(
            noise,
            turn=max(noise.turn * factor[0], floor.turn),
            shift_m=max(noise.shift_m * factor[1], floor.shift_m),
            jitter=max(noise.jitter * factor[2], floor.jitter),
        )
    return noise


def _independent(views: Views, grams: Array, before: Array) -> Array:
    """Return the standard deviations (C,), in pixels, of the independent errors.

    ``grams`` (V, 14, 14) contains, for each view, the Gram matrix of 14 vectors: the derivatives of the pixels with
    respect to the board's pose (6) and to the shared errors (7), and the residuals (1). ``before`` (C,) are the old
    values, which are kept for cameras with too few corners.
    """
    pose, last = slice(0, BOARD_PARAMETERS), BOARD_PARAMETERS + SHARED
    damped = grams[:, pose, pose] + 1e-9 * np.eye(BOARD_PARAMETERS)
    explained = np.linalg.solve(damped, grams[:, pose, last, None])[..., 0]
    rest = grams[:, last, last] - np.einsum("vi,vi->v", explained, grams[:, pose, last])
    freedom = 2 * (views.rows < len(views.index)).sum(axis=1) - BOARD_PARAMETERS
    found = before.copy()
    for camera in range(len(before)):
        rows = views.camera == camera
        if freedom[rows].sum() > 0:
            found[camera] = np.sqrt(max(rest[rows].sum() / freedom[rows].sum(), MIN_CORNER_PX**2))
    return found


def _mean_squares(views: Views, grams: Array, noise: ViewNoise, weights: Weights) -> Array:
    """Return the expected squares (3,) of the three kinds of shared errors (rotation, shift and delay), averaged over
    the views and divided by the variances in ``noise``."""
    std = noise.shared_std
    total, count = np.zeros(SHARED), 0
    pose, last = BOARD_PARAMETERS, BOARD_PARAMETERS + SHARED
    for board in np.unique(views.board):
        rows = np.flatnonzero(views.board == board)
        if len(rows) < 2:
            continue
        size = pose + SHARED * len(rows)
        normal, right = np.zeros((size, size)), np.zeros(size)
        for number, view in enumerate(rows):
            gram = grams[view]
            block = slice(pose + SHARED * number, pose + SHARED * (number + 1))
            normal[:pose, :pose] += gram[:pose, :pose]
            right[:pose] += gram[:pose, last]
            normal[:pose, block] = gram[:pose, pose:last] * std
            normal[block, :pose] = normal[:pose, block].T
            normal[block, block] = gram[pose:last, pose:last] * np.outer(std, std)
            normal[block, block] += np.eye(SHARED) * weights.view[view]
            right[block] = gram[pose:last, last] * std
        normal[np.arange(pose), np.arange(pose)] *= 1 + 1e-9
        inverse = np.linalg.inv(normal)
        latent = (inverse @ right)[pose:].reshape(-1, SHARED)
        variance = np.diag(inverse)[pose:].reshape(-1, SHARED)
        total += (weights.view[rows, None] * (latent**2 + variance)).sum(axis=0)
        count += len(rows)
    if not count:
        return np.ones(3)
    mean = total / count
    return np.array([mean[TURN].mean(), mean[SHIFT].mean(), mean[JITTER].mean()])
