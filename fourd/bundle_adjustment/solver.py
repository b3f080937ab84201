"""Bundle adjustment with a prior on the given calibration.

The solver uses the Levenberg-Marquardt algorithm. The points are eliminated with the Schur complement (Triggs et al.,
Bundle Adjustment - a Modern Synthesis, 2000, sec. 6.1). The cost is the sum of two terms: the reprojection error with a
Cauchy loss, and a Gaussian prior on the correction of each camera. The prior fixes the gauge: without it, the cost
would not change if all cameras and points were rotated, translated or scaled together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array

from fourd.bundle_adjustment.tracks import Observations
from fourd.cameras import Camera

Array = NDArray[np.float64]

ROTATION, POSITION, LOG_FOCAL, PRINCIPAL = slice(0, 3), slice(3, 6), 6, slice(7, 9)
"""Indices of a camera's rotation, position, logarithmic focal length and principal point in the vector of its 9
parameters."""
PARAMETERS = 9
"""Number of parameters per camera."""
MAX_STEPS = 40
MIN_RELATIVE_DECREASE = 1e-5
"""The solver stops when a step decreases the cost by less than this fraction of the cost."""
DAMPING = 1e-3
"""Initial damping factor of the Levenberg-Marquardt algorithm."""


@dataclass(frozen=True)
class Prior:
    """Standard deviations of the errors in the given cameras' parameters and in the feature positions.

    Attributes:
        rotation: standard deviation of rotations in radians; 0 fixes all rotations.
        position: (V,) standard deviation, in world units, of the position of each camera; 0 fixes all positions.
        focal: standard deviation of the logarithm of the focal length; 0 fixes all focal lengths.
        pixel: standard deviation of a feature's position in pixels. The default is larger than the measured value of a
            third of a pixel, because the errors of features on the same surface are correlated. With a smaller value,
            the adjustment fits these correlated errors and deforms rings of cameras.
        principal_px: standard deviation of the principal point in pixels; 0 fixes all principal points.
    """

    rotation: float
    position: Array
    focal: float
    pixel: float = 2.0
    principal_px: float = 0.0


@dataclass(frozen=True, eq=False)
class _State:
    cameras: tuple[Camera, ...]
    xyz: Array


def solve(
    given: Sequence[Camera], start: Sequence[Camera], tracks: Observations, xyz: Array, prior: Prior, scale_px: float
) -> tuple[tuple[Camera, ...], Array]:
    """Minimise the cost of bundle adjustment over the parameters of the cameras and the positions of the points.

    Args:
        given: cameras with the given calibration, which is the mean of the prior.
        start: initial cameras.
        tracks: observed features.
        xyz: (P, 3) initial positions of the points in world coordinates.
        prior: standard deviations of the errors in the given calibration.
        scale_px: scale of the Cauchy loss in pixels.

    Returns:
        the optimised cameras, and the optimised points (P, 3). Cameras without features keep their given calibration.
    """
    state = _State(tuple(start), xyz)
    damping, cost = DAMPING, _cost(state, given, tracks, prior, scale_px)
    for _ in range(MAX_STEPS):
        system = _System.at(state, given, tracks, prior, scale_px)
        gain = 0.0
        for _ in range(8):
            trial = _try_step(system, state, damping)
            after = np.inf if trial is None else _cost(trial, given, tracks, prior, scale_px)
            if trial is not None and after < cost:
                gain = (cost - after) / cost
                state, cost, damping = trial, after, max(damping / 10, 1e-9)
                break
            damping *= 10
        if gain < MIN_RELATIVE_DECREASE:
            break
    return state.cameras, state.xyz


def _try_step(system: _System, state: _State, damping: float) -> _State | None:
    """Return the state after a step, or None if the normal equations are singular or the step is not finite. A step
    with more damping can then succeed."""
    try:
        return system.step(state, damping)
    except (np.linalg.LinAlgError, ValueError, cv2.error):
        return None


def reprojection_errors_px(tracks: Observations, cameras: Sequence[Camera], xyz: Array) -> Array:
    """Return the reprojection error (M,), in pixels, of each feature, or infinity for points behind the camera."""
    residual, in_camera = _residuals(_State(tuple(cameras), xyz), tracks)
    return np.where(in_camera[:, 2] > 0, np.linalg.norm(residual, axis=1), np.inf)


@dataclass(frozen=True, eq=False)
class _System:
    """The normal equations of V cameras and P points, stored as blocks.

    Attributes:
        cameras: (V, 9, 9) diagonal blocks of the cameras.
        points: (P, 3, 3) diagonal blocks of the points.
        coupling: (M, 9, 3) blocks, one per feature, that couple the camera and the point of the feature.
        rhs_cameras: (V, 9) right-hand side of the cameras' equations.
        rhs_points: (P, 3) right-hand side of the points' equations.
        tracks: the M observed features.
    """

    cameras: Array
    points: Array
    coupling: Array
    rhs_cameras: Array
    rhs_points: Array
    tracks: Observations

    @classmethod
    def at(cls, state: _State, given: Sequence[Camera], tracks: Observations, prior: Prior, scale_px: float) -> _System:
        """Linearise the cost at ``state``, and build the normal equations."""
        residual, in_camera = _residuals(state, tracks)
        weight = _weights(residual, in_camera, prior, scale_px)
        by_camera, by_point = _jacobians(state, tracks, in_camera)
        by_camera[:, :, ~_free(prior)] = 0
        weighted = by_camera * weight[:, None, None]
        views, points = len(given), len(state.xyz)
        cameras, rhs_cameras = np.zeros((views, PARAMETERS, PARAMETERS)), np.zeros((views, PARAMETERS))
        np.add.at(cameras, tracks.camera, np.swapaxes(weighted, 1, 2) @ by_camera)
        np.add.at(rhs_cameras, tracks.camera, -np.einsum("mij,mi->mj", weighted, residual))
        precision, off = _prior_precision(prior, views), _corrections(state.cameras, given)
        cameras += precision[:, :, None] * np.eye(PARAMETERS)
        rhs_cameras -= precision * off
        blocks, rhs_points = np.zeros((points, 3, 3)), np.zeros((points, 3))
        np.add.at(blocks, tracks.point, np.swapaxes(by_point * weight[:, None, None], 1, 2) @ by_point)
        np.add.at(rhs_points, tracks.point, -np.einsum("mij,mi->mj", by_point * weight[:, None, None], residual))
        return cls(cameras, blocks, np.swapaxes(weighted, 1, 2) @ by_point, rhs_cameras, rhs_points, tracks)

    def step(self, state: _State, damping: float) -> _State:
        """Compute the state after a Levenberg-Marquardt step.

        The diagonal of the normal equations is multiplied by 1 + ``damping``.
        """
        views, points = len(self.cameras), len(self.points)
        cameras = self.cameras * (1 + damping * np.eye(PARAMETERS))
        inverse = np.linalg.inv(self.points * (1 + damping * np.eye(3)) + 1e-12 * np.eye(3))
        coupled = _sparse_blocks(self.coupling, self.tracks.camera, self.tracks.point, (views, points))
        eliminated = _sparse_blocks(
            self.coupling @ inverse[self.tracks.point], self.tracks.camera, self.tracks.point, (views, points)
        )
        whole = np.zeros((views, PARAMETERS, views, PARAMETERS))
        whole[np.arange(views), :, np.arange(views)] = cameras
        reduced = whole.reshape(views * PARAMETERS, -1) - (eliminated @ coupled.T).toarray()
        step = np.linalg.solve(reduced, self.rhs_cameras.ravel() - eliminated @ self.rhs_points.ravel())
        point_step = np.einsum("pij,pj->pi", inverse, self.rhs_points - (coupled.T @ step).reshape(points, 3))
        camera_steps = step.reshape(views, PARAMETERS)
        return _State(tuple(map(_update_camera, state.cameras, camera_steps)), state.xyz + point_step)


def _sparse_blocks(
    values: Array, rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, int]
) -> bsr_array:
    order = np.lexsort((columns, rows))
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=shape[0]))])
    size = (shape[0] * values.shape[1], shape[1] * values.shape[2])
    return bsr_array((values[order], columns[order], starts), shape=size)


def _residuals(state: _State, tracks: Observations) -> tuple[Array, Array]:
    """Return the residuals (M, 2) in pixels (projection minus feature), and the points (M, 3) of the features in camera
    coordinates."""
    rotation, centre, k = (
        np.stack([getattr(camera, name) for camera in state.cameras])[tracks.camera]
        for name in ("rotation", "centre", "intrinsics")
    )
    in_camera = np.einsum("mij,mj->mi", rotation, state.xyz[tracks.point] - centre)
    z = np.where(in_camera[:, 2] > 1e-6, in_camera[:, 2], 1e-6)
    pixel = np.einsum("mij,mj->mi", k[:, :2], in_camera / z[:, None])
    return pixel - tracks.pixel, in_camera


def _jacobians(state: _State, tracks: Observations, in_camera: Array) -> tuple[Array, Array]:
    """Return the Jacobians of the projections: an (M, 2, 9) array for the cameras' parameters, and an (M, 2, 3) array
    for the points' positions."""
    k, rotation = (
        np.stack([getattr(camera, name) for camera in state.cameras])[tracks.camera]
        for name in ("intrinsics", "rotation")
    )
    x, y, z = in_camera.T
    z = np.where(z > 1e-6, z, 1e-6)
    zero = np.zeros_like(z)
    flat = np.stack([np.stack([1 / z, zero, -x / z**2], -1), np.stack([zero, 1 / z, -y / z**2], -1)], 1)
    by_position = k[:, :2, :2] @ flat
    # The derivative of exp([w]x) @ p with respect to the rotation vector w at w = 0 is -[p]x, the cross-product matrix
    # of -p.
    cross_matrix = np.stack([np.stack([zero, z, -y], -1), np.stack([-z, zero, x], -1), np.stack([y, -x, zero], -1)], 1)
    by_log_focal = np.einsum("mij,mj->mi", k[:, :2, :2], in_camera[:, :2] / z[:, None])[..., None]
    by_principal = np.broadcast_to(np.eye(2), (len(in_camera), 2, 2))
    by_camera = [by_position @ cross_matrix, -by_position, by_log_focal, by_principal]
    return np.concatenate(by_camera, axis=2), by_position @ rotation


def _update_camera(camera: Camera, change: Array) -> Camera:
    """Translate a camera along its axes, rotate it about its centre, scale its focal length and shift its principal
    point."""
    rotation = cv2.Rodrigues(change[ROTATION])[0] @ camera.rotation
    centre = camera.centre + camera.rotation.T @ change[POSITION]
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, :2] *= np.exp(change[LOG_FOCAL])
    intrinsics[:2, 2] += change[PRINCIPAL]
    return replace(camera, intrinsics=intrinsics, rotation=rotation, translation=-rotation @ centre)


def _corrections(cameras: Sequence[Camera], given: Sequence[Camera]) -> Array:
    """Return the differences (V, 9): the parameters of ``cameras`` minus the parameters of the uncorrected cameras
    ``given``."""
    rows = []
    for camera, before in zip(cameras, given, strict=True):
        rotation = cv2.Rodrigues(camera.rotation @ before.rotation.T)[0].ravel()
        position = camera.rotation @ (camera.centre - before.centre)
        zoom = np.log(camera.intrinsics[1, 1] / before.intrinsics[1, 1])
        rows.append([*rotation, *position, zoom, *(camera.intrinsics[:2, 2] - before.intrinsics[:2, 2])])
    return np.array(rows)


def _prior_precision(prior: Prior, views: int) -> Array:
    """Return the inverse variances (V, 9) of the prior.

    For fixed parameters, the inverse variance is 1, because 0 would make the normal equations singular.
    """
    deviation = np.ones((views, PARAMETERS))
    deviation[:, ROTATION] = prior.rotation
    deviation[:, POSITION] = prior.position[:, None]
    deviation[:, LOG_FOCAL] = prior.focal
    deviation[:, PRINCIPAL] = prior.principal_px
    deviation[:, ~_free(prior)] = 1
    return deviation**-2


def _free(prior: Prior) -> NDArray[np.bool_]:
    """Return the mask (9,) of the camera parameters that are optimised."""
    free = np.zeros(PARAMETERS, bool)
    free[ROTATION], free[POSITION] = prior.rotation > 0, bool((prior.position > 0).all())
    free[LOG_FOCAL], free[PRINCIPAL] = prior.focal > 0, prior.principal_px > 0
    return free


def _weights(residual: Array, in_camera: Array, prior: Prior, scale_px: float) -> Array:
    """Return the weight (M,) of each squared error: the Cauchy weight divided by the square of ``Prior.pixel``, or 0
    for points behind the camera."""
    weight = 1 / (1 + np.square(residual).sum(axis=1) / scale_px**2) / prior.pixel**2
    return np.where(in_camera[:, 2] > 1e-6, weight, 0)


def _cost(state: _State, given: Sequence[Camera], tracks: Observations, prior: Prior, scale_px: float) -> float:
    residual, in_camera = _residuals(state, tracks)
    square = np.where(in_camera[:, 2] > 1e-6, np.square(residual).sum(axis=1), 1e6)
    robust = scale_px**2 * np.log1p(square / scale_px**2) / prior.pixel**2
    off = _corrections(state.cameras, given)
    return float(robust.sum() + (_prior_precision(prior, len(given)) * off**2).sum())
