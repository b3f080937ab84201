"""Motion of the board at each frame, from its positions in the frames before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fourd.recording.board_calibration.adjustment.rig import Poses

Array = NDArray[np.float64]

HALF_WINDOW = 2
"""The motion at a frame is computed from this frame and at most this number of frames on each side of it."""
END_WINDOW = 3
"""At the first and at the last frame of a sequence, the motion is computed from at most this number of frames."""
MAX_GAP = 2
"""Longest time between two successive frames of a sequence, as a multiple of the median time. At longer gaps, the
sequence is divided, because the motion between the two frames is unknown."""


def board_motion(frames: Sequence[int], boards: Poses) -> Array:
    """Return the motion (F, 6) of the board at each frame: angular velocity as a rotation vector, and velocity of the
    board's origin. The unit of time is the frame.

    The motion is the derivative of the polynomial through the poses of up to five successive frames (Fornberg,
    Generation of finite difference formulas on arbitrarily spaced grids, 1988). It is 0 for a frame without neighbours.

    Args:
        frames: F frame numbers, in ascending order.
        boards: F poses from board to world.
    """
    numbers = np.asarray(frames, float)
    motion = np.zeros((len(numbers), 6))
    if len(numbers) < 2:
        return motion
    gaps = np.diff(numbers)
    cuts = np.flatnonzero(gaps > MAX_GAP * np.median(gaps)) + 1
    for run in np.split(np.arange(len(numbers)), cuts):
        for place, index in enumerate(run):
            window = _window(run, place)
            turns = Rotation.from_matrix(boards.rotation[window] @ boards.rotation[index].T).as_rotvec()
            values = np.column_stack([turns, boards.translation[window] - boards.translation[index]])
            motion[index] = _derivative_weights(numbers[window] - numbers[index]) @ values
    return motion


def _window(run: NDArray[np.intp], place: int) -> NDArray[np.intp]:
    """Return the indices of the frames from which the board's motion at the frame ``run[place]`` is computed. ``run``
    contains the indices of the frames of one sequence."""
    half = min(HALF_WINDOW, place, len(run) - 1 - place)
    if half:
        return run[place - half : place + half + 1]
    return run[:END_WINDOW] if place == 0 else run[-END_WINDOW:]


def _derivative_weights(times: Array) -> Array:
    """Return the finite-difference weights of values at ``times`` for the first derivative at time 0.

    The weighted sum of the values is the derivative, at time 0, of the polynomial through the values.
    """
    powers = times[None] ** np.arange(len(times))[:, None]
    wanted = np.zeros(len(times))
    if len(times) > 1:
        wanted[1] = 1.0
    return np.asarray(np.linalg.solve(powers, wanted), np.float64)
