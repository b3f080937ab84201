"""Bundle adjustment of a rig, the shape of a board and its poses.

Iteratively reweighted least squares implement the Huber loss. The errors that all corners of one image share (see
:mod:`fourd.recording.board_calibration.adjustment.noise`) and the poses of the board are eliminated by Schur
complements, so the computing time grows linearly with the number of frames. The covariance of the cameras' parameters
is computed from the matrix of the reduced normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.optimization.levenberg_marquardt import Rules, Trial, minimize
from fourd.recording.board_calibration.adjustment.noise import (
    ViewNoise,
    Views,
    Weights,
    group_views,
    shared_derivatives,
    weigh,
)
from fourd.recording.board_calibration.adjustment.rig import (
    LENS,
    MIN_DEPTH,
    PARAMETERS,
    POSE,
    TIME,
    BoardShape,
    Corners,
    Poses,
    RigState,
    lens_vector,
    project,
)
from fourd.recording.board_calibration.adjustment.system import Free, RigEquations, build_system, squared_error

Array = NDArray[np.float64]

MIN_RELATIVE_DECREASE = 1e-6
"""The solver stops when a step decreases the cost by less than this fraction of the cost."""
RULES = Rules(max_steps=60, max_trials=8, min_relative_decrease=MIN_RELATIVE_DECREASE, min_damping=1e-10)
PRIOR_ASPECT = 0.005
"""Standard deviation of the prior on log(fx / fy). The mean of the prior is 0, because most cameras
have square pixels.
"""
PRIOR_CENTRE = 0.015
"""Standard deviation of the prior on the principal point, as a fraction of the image's longer side. The mean of the
prior is the image's centre.
"""
PRIOR_DISTORTION = np.array([0.3, 0.3, 0.005, 0.005, 0.3])
"""Standard deviations of the prior on k1, k2, p1, p2 and k3, whose mean is 0. Without a prior, some combinations of the
coefficients are undetermined if corners cover only a small part of the image or the board has only a few orientations.
"""
PRIOR_TIME = np.array([0.5, 0.5])
"""Standard deviations of the prior on the delay and on the readout, in frames. The mean of the prior is 0."""
PRIOR_THICKNESS_M = 0.005
"""Standard deviation of the prior on the board's thickness. The mean of the prior is 0."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Model of the corners' errors.

    Attributes:
        noise: standard deviations of the errors.
        huber_px: (C,) scale of the Huber loss in pixels.
    """

    noise: ViewNoise
    huber_px: Array


def solve_rig(start: RigState, corners: Corners, free: Free, errors: Errors, rules: Rules = RULES) -> RigState:
    """Minimise the Huber loss of the reprojection errors, with a weak prior on lenses, timing and shape.

    Args:
        start: initial rig, with the corners in front of the cameras.
        corners: observations.
        free: parameters that are adjusted. One camera's pose should be fixed, because moving all cameras and boards
            together would not change the cost.
        errors: model of the corners' errors.
        rules: rules of the solver.
    """
    problem = _Problem(corners, group_views(corners), free, errors)
    return minimize(problem.linearize, start, rules)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The arguments of :func:`solve_rig`, with the corners grouped by view."""

    corners: Corners
    views: Views
    free: Free
    errors: Errors

    def linearize(self, state: RigState) -> _Model:
        """Compute the weights at ``state``, and linearise the cost with these weights."""
        weights, shared = _weigh(state, self.corners, self.views, self.errors)
        plain, _ = build_system(state, self.corners, self.views, self.free, self.errors.noise, weights)
        cost = self.cost(state, weights, shared)
        return _Model(self, state, cost, weights, shared, _with_prior(plain, state, self.free))

    def cost(self, state: RigState, weights: Weights, shared: Array) -> float:
        corners = self.corners
        found = project(state, corners)
        if (found.depth < MIN_DEPTH).any():
            return float("inf")
        scale = np.sqrt(weights.corner) / self.errors.noise.corner_px[corners.camera]
        precision, offset = _prior(state, self.free)
        residual = corners.pixels - found.pixels
        error = squared_error(residual, shared, self.views, self.errors.noise, weights, scale)
        return error + float(offset @ precision @ offset)


@dataclass(frozen=True, eq=False)
class _Model:
    """The quadratic model of the cost at one state.

    Attributes:
        problem: the problem to solve.
        state: the state.
        cost: the cost at the state.
        weights: the weights of the squared errors at the state.
        shared: (N, 2, 7) the derivatives of the projected corners with respect to the errors that all corners of a view
            share.
        equations: the normal equations, with the prior.
    """

    problem: _Problem
    state: RigState
    cost: float
    weights: Weights
    shared: Array
    equations: RigEquations

    def try_step(self, damping: float) -> Trial[RigState]:
        """Make a step, unless the model predicts that it would hardly decrease the cost."""
        step = self.equations.solve(damping)
        if self.equations.predicted_decrease(*step) < MIN_RELATIVE_DECREASE * self.cost:
            return Trial(self.state, self.cost, is_last=True)
        state = move(self.state, self.problem.free, *step)
        return Trial(state, self.problem.cost(state, self.weights, self.shared))


def move(state: RigState, free: Free, shared: Array, boards: Array) -> RigState:
    """Apply one step of the solver to a rig. ``shared`` (P,) contains the changes of the cameras and the board's shape.
    ``boards`` (F, 6) contains, for each pose of the board, a rotation vector and a translation that change the pose."""
    count = len(state.cameras) * PARAMETERS
    cameras = shared[:count].reshape(-1, PARAMETERS)
    turns = np.stack([cv2.Rodrigues(step[:3])[0] for step in boards]) if len(boards) else np.zeros((0, 3, 3))
    moved = Poses(turns @ state.boards.rotation, state.boards.translation + boards[:, 3:])
    timing = state.timing
    if timing is not None:
        delay, readout = cameras[:, TIME].T
        timing = replace(timing, delay=timing.delay + delay, readout=timing.readout + readout)
    shape = state.shape
    if free.shape_unknowns and shape is not None:
        rest = shared[count:]
        displaced = free.offset_std_m.size
        offsets = rest[:displaced].reshape(-1, 3) if displaced else 0.0
        thickness = float(rest[-1]) if free.thickness else 0.0
        shape = BoardShape(shape.offsets_m + offsets, shape.thickness_m + thickness)
    return RigState(tuple(map(_move_camera, state.cameras, cameras)), moved, timing, shape)


def _weigh(state: RigState, corners: Corners, views: Views, errors: Errors) -> tuple[Weights, Array]:
    """Return the weights of the corners and views, and the derivatives (N, 2, 7) of the projected corners with respect
    to the 7 error components that all corners of a view share (see
    :mod:`fourd.recording.board_calibration.adjustment.noise`)."""
    found = project(state, corners)
    shared = shared_derivatives(state, corners, found)
    residual = corners.pixels - found.pixels
    return weigh(views, residual, shared, errors.noise, corners.camera, errors.huber_px), shared


def _with_prior(equations: RigEquations, state: RigState, free: Free) -> RigEquations:
    """Add the prior to the normal equations, and 1 to the diagonal elements of fixed parameters."""
    precision, offset = _prior(state, free)
    fixed = np.concatenate([~free.cameras.ravel(), np.zeros(free.shape_unknowns, bool)])
    kept = equations.kept + precision + np.diag(fixed.astype(float))
    return replace(equations, kept=kept, rhs_kept=equations.rhs_kept - precision @ offset)


def _prior(state: RigState, free: Free) -> tuple[Array, Array]:
    """Return the precision matrix (P, P) of the prior, and the differences (P,) of the parameters from the prior's
    mean."""
    count = len(state.cameras) * PARAMETERS
    size = count + free.shape_unknowns
    precision, offset = np.zeros((size, size)), np.zeros(size)
    for index, camera in enumerate(state.cameras):
        start, mask = index * PARAMETERS, free.cameras[index]
        if mask[LENS].all():
            lens = lens_vector(camera)
            # log(fx / fy) is approximated by (fx - fy) / f, where f, the mean of fx and fy, is treated as a constant.
            aspect = np.zeros(PARAMETERS)
            aspect[LENS][:2] = np.array([1, -1]) / (PRIOR_ASPECT * lens[:2].mean())
            centre = PRIOR_CENTRE * max(camera.width, camera.height)
            diagonal = np.zeros(PARAMETERS)
            diagonal[LENS][2:] = 1 / np.concatenate([[centre, centre], PRIOR_DISTORTION]) ** 2
            block = slice(start, start + PARAMETERS)
            precision[block, block] = np.diag(diagonal) + np.outer(aspect, aspect)
            offset[block][LENS] = lens
            offset[block][LENS][2:4] -= (camera.width / 2, camera.height / 2)
        if state.timing is not None:
            for number, value in enumerate((state.timing.delay[index], state.timing.readout[index])):
                place = start + TIME.start + number
                precision[place, place] = mask[TIME][number] / PRIOR_TIME[number] ** 2
                offset[place] = value
    if len(free.offset_std_m) and state.shape is not None:
        corners = slice(count, count + free.offset_std_m.size)
        precision[corners, corners] = np.diag(1 / free.offset_std_m.ravel() ** 2)
        offset[corners] = state.shape.offsets_m.ravel()
    if free.thickness and state.shape is not None:
        precision[-1, -1], offset[-1] = 1 / PRIOR_THICKNESS_M**2, state.shape.thickness_m
    return precision, offset


def standard_deviations(state: RigState, corners: Corners, free: Free, errors: Errors) -> Array:
    """Return the standard deviations (C, 17) of the cameras' parameters, in radians, metres, pixels, frames or without
    unit.

    Fixed parameters have a standard deviation of 0.

    The covariance is the sandwich estimate H^-1 G H^-1 with frames as clusters (Liang and Zeger 1986). H is the matrix
    of the reduced normal equations. G is the sum of the outer products of the frames' gradients, divided by c^2, plus
    the precision of the prior. The factor c is the Huber loss's mean curvature divided by the mean weight (Huber,
    Robust Statistics, 1981, sec. 7.6). The estimate remains valid if errors are correlated within a frame, or larger
    than the error model assumes.
    """
    views = group_views(corners)
    weights, _ = _weigh(state, corners, views, errors)
    plain, gradients = build_system(state, corners, views, free, errors.noise, weights)
    reduced, eliminated = _with_prior(plain, state, free).reduce(0.0)
    # Scaling to a unit diagonal keeps parameters of different units comparable.
    scale = 1 / np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    inverse = np.linalg.pinv(reduced * np.outer(scale, scale), rcond=1e-14, hermitian=True) * np.outer(scale, scale)
    scores = gradients - np.einsum("fij,fj->fi", eliminated.values, plain.rhs_blocks)
    # The covariance of the prior's gradient is added. This gradient is ``precision`` times the offset from the prior's
    # mean. The covariance of the offset is the inverse of ``precision``, so the covariance of the gradient is
    # ``precision``.
    precision, _ = _prior(state, free)
    covariance = inverse @ (scores.T @ scores / _curvature(weights.corner) ** 2 + precision) @ inverse
    variance = np.diag(covariance)[: free.cameras.size].reshape(free.cameras.shape)
    return np.asarray(np.sqrt(np.maximum(variance, 0)) * free.cameras, np.float64)


def _curvature(weights: Array) -> float:
    """Return the mean curvature of the Huber loss of two-dimensional errors, divided by the mean weight.

    For errors larger than the scale of the loss, the curvature is 0 in the direction of the error, and equal to the
    weight in the perpendicular direction.
    """
    return float(np.mean(np.where(weights < 1, weights / 2, 1.0)) / np.mean(weights))


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
