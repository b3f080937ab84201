"""Bundle adjustment with a prior on the given calibration.

The cost is the sum of two terms: the reprojection error with a Cauchy loss, and a Gaussian prior on the correction of
each camera. The prior fixes the gauge: without it, the cost would not change if all cameras and points were rotated,
translated or scaled together. :mod:`fourd.base.optimization` minimises the cost and eliminates the points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.optimization.levenberg_marquardt import Rules, Trial, minimize
from fourd.base.optimization.schur import NormalEquations, SparseCoupling
from fourd.recording.calibration.adjustment.tracks import Observations

Array = NDArray[np.float64]

ROTATION, POSITION, LOG_FOCAL, PRINCIPAL = slice(0, 3), slice(3, 6), 6, slice(7, 9)
"""Indices of a camera's rotation, position, logarithmic focal length and principal point in the vector of its 9
parameters."""
PARAMETERS = 9
"""Number of parameters per camera."""
RULES = Rules(max_steps=40, max_trials=8, min_relative_decrease=1e-5, min_damping=1e-9)
RIDGE = 1e-12
"""Number that is added to the diagonals of the points' equations."""


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
    problem = _Problem(given, tracks, prior, scale_px)
    state = minimize(problem.linearize, _State(tuple(start), xyz), RULES)
    return state.cameras, state.xyz


def reprojection_errors_px(tracks: Observations, cameras: Sequence[Camera], xyz: Array) -> Array:
    """Return the reprojection error (M,), in pixels, of each feature, or infinity for points behind the camera."""
    residual, in_camera = _residuals(_State(tuple(cameras), xyz), tracks)
    return np.where(in_camera[:, 2] > 0, np.linalg.norm(residual, axis=1), np.inf)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The arguments of :func:`solve`, except the initial state."""

    given: Sequence[Camera]
    tracks: Observations
    prior: Prior
    scale_px: float

    def linearize(self, state: _State) -> _Model:
        """Linearise the cost at ``state``, and build the normal equations of the V cameras and P points."""
        tracks, prior, views, points = self.tracks, self.prior, len(self.given), len(state.xyz)
        residual, in_camera = _residuals(state, tracks)
        weight = _weights(residual, in_camera, prior, self.scale_px)
        by_camera, by_point = _jacobians(state, tracks, in_camera)
        by_camera[:, :, ~_free(prior)] = 0
        weighted = by_camera * weight[:, None, None]
        cameras, rhs_cameras = np.zeros((views, PARAMETERS, PARAMETERS)), np.zeros((views, PARAMETERS))
        np.add.at(cameras, tracks.camera, np.swapaxes(weighted, 1, 2) @ by_camera)
        np.add.at(rhs_cameras, tracks.camera, -np.einsum("mij,mi->mj", weighted, residual))
        precision, off = _prior_precision(prior, views), _corrections(state.cameras, self.given)
        cameras += precision[:, :, None] * np.eye(PARAMETERS)
        rhs_cameras -= precision * off
        whole = np.zeros((views, PARAMETERS, views, PARAMETERS))
        whole[np.arange(views), :, np.arange(views)] = cameras
        kept = whole.reshape(views * PARAMETERS, -1)
        blocks, rhs_points = np.zeros((points, 3, 3)), np.zeros((points, 3))
        np.add.at(blocks, tracks.point, np.swapaxes(by_point * weight[:, None, None], 1, 2) @ by_point)
        np.add.at(rhs_points, tracks.point, -np.einsum("mij,mi->mj", by_point * weight[:, None, None], residual))
        coupling = SparseCoupling.from_blocks(
            np.swapaxes(weighted, 1, 2) @ by_point, tracks.camera, tracks.point, (views, points)
        )
        equations = NormalEquations(kept, blocks, coupling, rhs_cameras.ravel(), rhs_points, RIDGE)
        return _Model(self, state, self.cost(state), equations)

    def cost(self, state: _State) -> float:
        residual, in_camera = _residuals(state, self.tracks)
        square = np.where(in_camera[:, 2] > 1e-6, np.square(residual).sum(axis=1), 1e6)
        robust = self.scale_px**2 * np.log1p(square / self.scale_px**2) / self.prior.pixel**2
        off = _corrections(state.cameras, self.given)
        return float(robust.sum() + (_prior_precision(self.prior, len(self.given)) * off**2).sum())


@dataclass(frozen=True, eq=False)
class _Model:
    """The quadratic model of the cost at one state."""

    problem: _Problem
    state: _State
    cost: float
    equations: NormalEquations[SparseCoupling]

    def try_step(self, damping: float) -> Trial[_State]:
        """Make a step. It is rejected if the normal equations are singular or the step is not finite. A step with more
        damping can then succeed."""
        try:
            steps, point_steps = self.equations.solve(damping)
            cameras = map(_update_camera, self.state.cameras, steps.reshape(-1, PARAMETERS))
            state = _State(tuple(cameras), self.state.xyz + point_steps)
        except (np.linalg.LinAlgError, ValueError, cv2.error):
            return Trial(self.state, np.inf)
        return Trial(state, self.problem.cost(state))


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
