"""Adjustment of a rig together with the motion of the board and the standard deviations of the errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.recording.board_calibration.adjustment.motion import board_motion
from fourd.recording.board_calibration.adjustment.noise import (
    ViewNoise,
    estimate_noise,
    group_views,
    shared_derivatives,
    weigh,
)
from fourd.recording.board_calibration.adjustment.rig import Corners, RigState, project
from fourd.recording.board_calibration.adjustment.solver import RULES, Errors, solve_rig, standard_deviations
from fourd.recording.board_calibration.adjustment.system import Free

Array = NDArray[np.float64]

ROUNDS = 10
FINAL_RULES = replace(RULES, damping=1e-6)
"""Rules of the final adjustment of :func:`refine_rig`. A small damping factor saves steps near the minimum."""
ROUND_RULES = replace(FINAL_RULES, max_steps=2)
"""Rules of the adjustments in the rounds before."""
HUBER = 1.0
"""Scale of the Huber loss, as a multiple of the corners' standard deviation."""
TURN_STD, SHIFT_STD, JITTER_STD = 1e-3, 2e-4, 0.05
"""Initial standard deviations of the errors that all corners of a view share: rotation in radians, shift as a fraction
of the board's largest extent, and delay in frames."""
MIN_SHARE = 0.02
"""Each standard deviation of the shared errors is at least this fraction of its initial value."""
CONVERGED = 0.01
"""The rounds end when the relative change of every standard deviation is at most this value."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of an adjustment.

    Attributes:
        state: the adjusted rig.
        std: (C, 17) standard deviations of the cameras' parameters, in radians, metres, pixels, frames or without unit.
            Fixed parameters have a standard deviation of 0.
    """

    state: RigState
    std: Array


def refine_rig(start: RigState, corners: Corners, frames: Sequence[int], free: Free, corner_px: Array) -> Solution:
    """Adjust the cameras of a rig and the positions of the board to observed corners, in several rounds.

    Each round recomputes the motion of the board, adjusts the rig, and then re-estimates the standard deviations of the
    errors. After the rounds, the rig is adjusted once more.

    Args:
        start: a rig whose reprojection errors are at most a few pixels.
        corners: observations without gross errors.
        frames: frame number of each position of the board.
        free: parameters that are adjusted.
        corner_px: (C,) initial standard deviations of the corners' independent errors.
    """
    size = float(np.ptp(corners.xyz, axis=0).max())
    jitter = JITTER_STD if start.timing is not None else 0.0
    noise = ViewNoise(corner_px, TURN_STD, SHIFT_STD * size, jitter)
    floor = ViewNoise(corner_px, MIN_SHARE * TURN_STD, MIN_SHARE * SHIFT_STD * size, MIN_SHARE * jitter)
    state = start
    for _ in range(ROUNDS):
        state = with_motion(state, frames)
        state = solve_rig(state, corners, free, _errors(noise), ROUND_RULES)
        before, noise = noise, _improve(state, corners, noise, floor)
        if _largest_change(before, noise) < CONVERGED:
            break
    state = solve_rig(with_motion(state, frames), corners, free, _errors(noise), FINAL_RULES)
    return Solution(state, standard_deviations(state, corners, free, _errors(noise)))


def with_motion(state: RigState, frames: Sequence[int]) -> RigState:
    """Return the rig with recomputed motions of the board: the angular velocity and the velocity at each position of
    the board. If the rig has no timing, it is returned unchanged."""
    if state.timing is None:
        return state
    return replace(state, timing=replace(state.timing, motion=board_motion(frames, state.boards)))


def _errors(noise: ViewNoise) -> Errors:
    return Errors(noise, HUBER * noise.corner_px)


def _improve(state: RigState, corners: Corners, noise: ViewNoise, floor: ViewNoise) -> ViewNoise:
    views, found = group_views(corners), project(state, corners)
    shared = shared_derivatives(state, corners, found)
    weights = weigh(views, corners.pixels - found.pixels, shared, noise, corners.camera, HUBER * noise.corner_px)
    return estimate_noise(state, corners, found, views, noise, weights, floor)


def _largest_change(before: ViewNoise, after: ViewNoise) -> float:
    """Return the largest relative change of a standard deviation."""
    pairs = [np.concatenate([noise.corner_px, noise.shared_std]) for noise in (before, after)]
    return float(np.abs(np.log((pairs[1] + 1e-12) / (pairs[0] + 1e-12))).max())
