"""Bundle adjustment of cameras that are nearly right: what the features say, and how far the given ones may be off.

Levenberg-Marquardt with the points eliminated (Triggs et al., Bundle Adjustment: A Modern Synthesis, 2000, sec. 6.1)
on reprojection errors with Cauchy's loss, and a normal prior on each camera's correction. The priors hold the gauge:
without them all cameras could turn, move and grow together.
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

TURN, MOVE, ZOOM = slice(0, 3), slice(3, 6), 6
PARAMETERS = 7
MOST_STEPS = 40
LEAST_GAIN = 1e-5
DAMPING = 1e-3


@dataclass(frozen=True)
class Prior:
    """Standard deviations of the given calibration.

    Attributes:
        rotation: radians; like the next two, 0 holds it fixed.
        position: world units, of each camera (V,).
        focal: of the focal length's logarithm.
        pixel: of a feature's place, in pixels. More than the third of a pixel that they miss by: errors of features on
            one surface are alike, and a smaller one bends rings of cameras.
    """

    rotation: float
    position: Array
    focal: float
    pixel: float = 2.0


@dataclass(frozen=True, eq=False)
class _State:
    cameras: tuple[Camera, ...]
    xyz: Array


def adjusted(
    given: Sequence[Camera], start: Sequence[Camera], found: Observations, xyz: Array, prior: Prior, scale_px: float
) -> tuple[tuple[Camera, ...], Array]:
    """Cameras and points (P, 3) that agree with the features, sought from ``start`` and ``xyz``.

    ``given`` is what the prior is about, ``scale_px`` the error beyond which features say little. Cameras without
    features come out as given.
    """
    state = _State(tuple(start), xyz)
    damping, cost = DAMPING, _cost(state, given, found, prior, scale_px)
    for _ in range(MOST_STEPS):
        system = _System.at(state, given, found, prior, scale_px)
        gain = 0.0
        for _ in range(8):
            trial = system.solved(state, damping)
            after = _cost(trial, given, found, prior, scale_px)
            if after < cost:
                gain = (cost - after) / cost
                state, cost, damping = trial, after, max(damping / 10, 1e-9)
                break
            damping *= 10
        if gain < LEAST_GAIN:
            break
    return state.cameras, state.xyz


def errors_px(found: Observations, cameras: Sequence[Camera], xyz: Array) -> Array:
    """(M,) distance of each feature from where its point projects; infinite behind the camera."""
    residual, in_camera = _residuals(_State(tuple(cameras), xyz), found)
    return np.where(in_camera[:, 2] > 0, np.linalg.norm(residual, axis=1), np.inf)


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations in blocks: cameras (V, 7, 7), points (P, 3, 3), and what ties each feature's two (M, 7, 3)."""

    cameras: Array
    points: Array
    ties: Array
    to_cameras: Array
    to_points: Array
    found: Observations

    @classmethod
    def at(cls, state: _State, given: Sequence[Camera], found: Observations, prior: Prior, scale_px: float) -> _System:
        residual, in_camera = _residuals(state, found)
        weight = _weights(residual, in_camera, prior, scale_px)
        by_camera, by_point = _jacobians(state, found, in_camera)
        by_camera[:, :, ~_free(prior)] = 0
        weighted = by_camera * weight[:, None, None]
        views, points = len(given), len(state.xyz)
        cameras, to_cameras = np.zeros((views, PARAMETERS, PARAMETERS)), np.zeros((views, PARAMETERS))
        np.add.at(cameras, found.camera, np.swapaxes(weighted, 1, 2) @ by_camera)
        np.add.at(to_cameras, found.camera, -np.einsum("mij,mi->mj", weighted, residual))
        stiffness, off = _stiffness(prior, views), _corrections(state.cameras, given)
        cameras += stiffness[:, :, None] * np.eye(PARAMETERS)
        to_cameras -= stiffness * off
        blocks, to_points = np.zeros((points, 3, 3)), np.zeros((points, 3))
        np.add.at(blocks, found.point, np.swapaxes(by_point * weight[:, None, None], 1, 2) @ by_point)
        np.add.at(to_points, found.point, -np.einsum("mij,mi->mj", by_point * weight[:, None, None], residual))
        return cls(cameras, blocks, np.swapaxes(weighted, 1, 2) @ by_point, to_cameras, to_points, found)

    def solved(self, state: _State, damping: float) -> _State:
        """The state after a step with the diagonal grown by ``damping``."""
        views, points = len(self.cameras), len(self.points)
        cameras = self.cameras * (1 + damping * np.eye(PARAMETERS))
        inverse = np.linalg.inv(self.points * (1 + damping * np.eye(3)) + 1e-12 * np.eye(3))
        tied = _blocks(self.ties, self.found.camera, self.found.point, (views, points))
        eliminated = _blocks(
            self.ties @ inverse[self.found.point], self.found.camera, self.found.point, (views, points)
        )
        whole = np.zeros((views, PARAMETERS, views, PARAMETERS))
        whole[np.arange(views), :, np.arange(views)] = cameras
        reduced = whole.reshape(views * PARAMETERS, -1) - (eliminated @ tied.T).toarray()
        step = np.linalg.solve(reduced, self.to_cameras.ravel() - eliminated @ self.to_points.ravel())
        moved = np.einsum("pij,pj->pi", inverse, self.to_points - (tied.T @ step).reshape(points, 3))
        changes = step.reshape(views, PARAMETERS)
        return _State(tuple(map(_changed, state.cameras, changes)), state.xyz + moved)


def _blocks(values: Array, rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, int]) -> bsr_array:
    order = np.lexsort((columns, rows))
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=shape[0]))])
    size = (shape[0] * values.shape[1], shape[1] * values.shape[2])
    return bsr_array((values[order], columns[order], starts), shape=size)


def _residuals(state: _State, found: Observations) -> tuple[Array, Array]:
    """Projections less features (M, 2), and the points in their cameras (M, 3)."""
    rotation, centre, k = (
        np.stack([getattr(camera, name) for camera in state.cameras])[found.camera]
        for name in ("rotation", "centre", "intrinsics")
    )
    in_camera = np.einsum("mij,mj->mi", rotation, state.xyz[found.point] - centre)
    z = np.where(in_camera[:, 2] > 1e-6, in_camera[:, 2], 1e-6)
    pixel = np.einsum("mij,mj->mi", k[:, :2], in_camera / z[:, None])
    return pixel - found.pixel, in_camera


def _jacobians(state: _State, found: Observations, in_camera: Array) -> tuple[Array, Array]:
    """Of the projections: by a camera's turn, move and zoom (M, 2, 7), and by a point's place (M, 2, 3)."""
    k, rotation = (
        np.stack([getattr(camera, name) for camera in state.cameras])[found.camera]
        for name in ("intrinsics", "rotation")
    )
    x, y, z = in_camera.T
    z = np.where(z > 1e-6, z, 1e-6)
    zero = np.zeros_like(z)
    flat = np.stack([np.stack([1 / z, zero, -x / z**2], -1), np.stack([zero, 1 / z, -y / z**2], -1)], 1)
    by_place = k[:, :2, :2] @ flat
    # d(exp(w) p)/dw = -[p]x
    crossed = np.stack([np.stack([zero, z, -y], -1), np.stack([-z, zero, x], -1), np.stack([y, -x, zero], -1)], 1)
    zoom = np.einsum("mij,mj->mi", k[:, :2, :2], in_camera[:, :2] / z[:, None])[..., None]
    return np.concatenate([by_place @ crossed, -by_place, zoom], axis=2), by_place @ rotation


def _changed(camera: Camera, change: Array) -> Camera:
    """A camera moved in its own frame, then turned about its centre, then zoomed."""
    rotation = cv2.Rodrigues(change[TURN])[0] @ camera.rotation
    centre = camera.centre + camera.rotation.T @ change[MOVE]
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, :2] *= np.exp(change[ZOOM])
    return replace(camera, intrinsics=intrinsics, rotation=rotation, translation=-rotation @ centre)


def _corrections(cameras: Sequence[Camera], given: Sequence[Camera]) -> Array:
    """(V, 7) turn, move and zoom that lead from the given cameras to these."""
    rows = []
    for camera, before in zip(cameras, given, strict=True):
        turn = cv2.Rodrigues(camera.rotation @ before.rotation.T)[0].ravel()
        move = camera.rotation @ (camera.centre - before.centre)
        rows.append([*turn, *move, np.log(camera.intrinsics[1, 1] / before.intrinsics[1, 1])])
    return np.array(rows)


def _stiffness(prior: Prior, views: int) -> Array:
    """(V, 7) inverse variances; what is held gets one that keeps the equations solvable."""
    deviation = np.ones((views, PARAMETERS))
    deviation[:, TURN] = prior.rotation
    deviation[:, MOVE] = prior.position[:, None]
    deviation[:, ZOOM] = prior.focal
    deviation[:, ~_free(prior)] = 1
    return deviation**-2


def _free(prior: Prior) -> NDArray[np.bool_]:
    """(7,) which of a camera's parameters are not held."""
    free = np.zeros(PARAMETERS, bool)
    free[TURN], free[MOVE], free[ZOOM] = prior.rotation > 0, bool((prior.position > 0).all()), prior.focal > 0
    return free


def _weights(residual: Array, in_camera: Array, prior: Prior, scale_px: float) -> Array:
    """(M,) of the squared errors: Cauchy's, over the variance of a feature; none behind a camera."""
    weight = 1 / (1 + np.square(residual).sum(axis=1) / scale_px**2) / prior.pixel**2
    return np.where(in_camera[:, 2] > 1e-6, weight, 0)


def _cost(state: _State, given: Sequence[Camera], found: Observations, prior: Prior, scale_px: float) -> float:
    residual, in_camera = _residuals(state, found)
    square = np.where(in_camera[:, 2] > 1e-6, np.square(residual).sum(axis=1), 1e6)
    robust = scale_px**2 * np.log1p(square / scale_px**2) / prior.pixel**2
    off = _corrections(state.cameras, given)
    return float(robust.sum() + (_stiffness(prior, len(given)) * off**2).sum())
