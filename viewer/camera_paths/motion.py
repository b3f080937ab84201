"""Smooth motion through the poses of key frames.

The shape of the path and the speed along it are separate, so that a change of the times of key frames does not change
the shape. The shape is a curve over a parameter s: a natural cubic spline for the position and the field of view, and
cubic Bezier curves of quaternions (Shoemake 1985) with continuous angular velocity for the rotation. The spacing of
the key frames in s is the square root of their distance (centripetal parameterisation), with which a spline makes no
loops between key frames of uneven distances (Yuksel et al. 2011). A monotone cubic spline (PCHIP, Fritsch and Butland
1984) maps times to s, so that the camera never moves backwards between two key frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from fourd.viewer.navigation.pose import Pose

Array = NDArray[np.float64]
Easing = Literal["smooth", "stop", "cut"]

_AT_REST = 1e-7
"""Two poses count as equal if their distance, see :func:`_steps`, is at most this value."""


class Motion:
    """Poses over time.

    Between two key frames with equal poses, and from a key frame with the easing "cut" to the next one, the camera
    rests. At a key frame with the easing "stop", its speed falls to 0 and rises again.

    Args:
        poses: poses of the key frames, at least 1.
        seconds: (N,) times of the key frames, increasing.
        easing: easing of each key frame.
        loop_seconds: time at which the camera is back at the first key frame, after the last time, or None.
    """

    def __init__(
        self, poses: Sequence[Pose], seconds: Array, easing: Sequence[Easing], loop_seconds: float | None = None
    ) -> None:
        if loop_seconds is not None:
            poses, easing = (*poses, poses[0]), (*easing, easing[0])
            seconds = np.append(seconds, loop_seconds)
        steps = _steps(poses)
        ends = [i + 1 for i, step in enumerate(steps) if step <= _AT_REST or easing[i] == "cut"]
        starts = [0, *ends]
        self._poses = tuple(poses)
        self._starts = seconds[starts]
        self._runs: list[_Run] = []
        for start, end in zip(starts, [*ends, len(poses)], strict=True):
            part = slice(start, end)
            is_closed = loop_seconds is not None and end - start == len(poses) > 2
            lengths = np.sqrt(steps[start : end - 1])
            self._runs.append(_Run.fit(poses[part], seconds[part], lengths, easing[part], is_closed=is_closed))

    def at(self, seconds: Array) -> list[Pose]:
        """Return the poses at times (N,). Before the first key frame and after the last one, the camera rests."""
        numbers = np.clip(np.searchsorted(self._starts, seconds, side="right") - 1, 0, None)
        poses: dict[int, Pose] = {}
        for number in np.unique(numbers):
            chosen = np.flatnonzero(numbers == number)
            poses |= dict(zip(chosen.tolist(), self._runs[number].at(seconds[chosen]), strict=True))
        return [poses[index] for index in range(len(seconds))]


@dataclass(frozen=True, eq=False)
class _Run:
    """A part of the motion without rests and cuts. If it is a single pose, the splines are None."""

    poses: tuple[Pose, ...]
    seconds: Array
    progress: CubicHermiteSpline | None
    values: CubicSpline | None
    rotations: _Turns | None

    @classmethod
    def fit(
        cls, poses: Sequence[Pose], seconds: Array, lengths: Array, easing: Sequence[Easing], *, is_closed: bool
    ) -> _Run:
        if len(poses) == 1:
            return cls(tuple(poses), seconds, None, None, None)
        s = np.concatenate([[0.0], np.cumsum(lengths)])
        values = np.stack([_to_vector(pose) for pose in poses])
        rotations = _Turns.fit(s, np.stack([pose.rotation for pose in poses]), is_closed=is_closed)
        if is_closed:
            values[-1] = values[0]
            curve = CubicSpline(s, values, bc_type="periodic")
        else:
            curve = CubicSpline(s, values, bc_type="natural")
        speeds = _speeds(seconds, s, is_closed=is_closed)
        speeds[[each == "stop" for each in easing]] = 0
        return cls(tuple(poses), seconds, CubicHermiteSpline(seconds, s, speeds), curve, rotations)

    def at(self, times: Array) -> list[Pose]:
        if self.progress is None or self.values is None or self.rotations is None:
            return [self.poses[0]] * len(times)
        s = np.asarray(self.progress(np.clip(times, self.seconds[0], self.seconds[-1])), np.float64)
        rotations, values = self.rotations.at(s), np.asarray(self.values(s), np.float64)
        numbers = np.clip(np.searchsorted(self.seconds, times, side="right") - 1, 0, len(self.poses) - 1)
        return [
            # The poses of key frames are returned as they are, without rounding errors.
            self.poses[number]
            if time == self.seconds[number] or time <= self.seconds[0] or time >= self.seconds[-1]
            else _from_vector(value, rotation, self.poses[number].up)
            for number, time, value, rotation in zip(numbers, times, values, rotations, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class _Turns:
    """A smooth curve through rotations.

    Attributes:
        s: (N,) parameters of the rotations.
        rotations: the N rotations R_camera_world.
        rates: (N, 3) angular velocities in camera axes, in radians per unit of s.
    """

    s: Array
    rotations: Rotation
    rates: Array

    @classmethod
    def fit(cls, s: Array, matrices: Array, *, is_closed: bool) -> _Turns:
        """Each angular velocity is that of the parabola through a rotation and its neighbours. At an open end, the
        angular acceleration is 0."""
        turns = Rotation.from_matrix(matrices)
        steps = np.diff(s)
        means = (turns[1:] * turns[:-1].inv()).as_rotvec() / steps[:, None]
        before, after = (means[:-1], steps[:-1, None]), (means[1:], steps[1:, None])
        inner = (after[1] * before[0] + before[1] * after[0]) / (before[1] + after[1])
        if is_closed:
            seam = (steps[0] * means[-1] + steps[-1] * means[0]) / (steps[0] + steps[-1])
            first = last = seam
        elif len(inner) == 0:
            first = last = means[0]
        else:
            first, last = 1.5 * means[0] - 0.5 * inner[0], 1.5 * means[-1] - 0.5 * inner[-1]
        return cls(s, turns, np.concatenate([[first], inner, [last]]))

    def at(self, s: Array) -> Array:
        """Return the rotation matrices (M, 3, 3) at ``s`` (M,), by de Casteljau's algorithm with spherical
        interpolation."""
        numbers = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 2)
        steps = (self.s[numbers + 1] - self.s[numbers])[:, None]
        shares = (s - self.s[numbers])[:, None] / steps
        start, end = self.rotations[numbers], self.rotations[numbers + 1]
        leave = Rotation.from_rotvec(steps / 3 * self.rates[numbers])
        arrive = Rotation.from_rotvec(-steps / 3 * self.rates[numbers + 1])
        points = [start, leave * start, arrive * end, end]
        while len(points) > 1:
            points = [_slerp(one, other, shares) for one, other in pairwise(points)]
        return points[0].as_matrix()


def _slerp(start: Rotation, end: Rotation, shares: Array) -> Rotation:
    return Rotation.from_rotvec(shares * (end * start.inv()).as_rotvec()) * start


def _speeds(seconds: Array, s: Array, *, is_closed: bool) -> Array:
    """Return ds/dt (N,) at the key frames, with which the cubic between them is monotone."""
    if not is_closed:
        return np.asarray(PchipInterpolator(seconds, s).derivative()(seconds), np.float64)
    times = np.concatenate(
        [[seconds[0] - (seconds[-1] - seconds[-2])], seconds, [seconds[-1] + seconds[1] - seconds[0]]]
    )
    wrapped = np.concatenate([[s[0] - (s[-1] - s[-2])], s, [s[-1] + s[1] - s[0]]])
    return np.asarray(PchipInterpolator(times, wrapped).derivative()(seconds), np.float64)


def _steps(poses: Sequence[Pose]) -> Array:
    """Return the distances (N - 1,) between successive poses, without unit: a turn of 1 radian, a step as long as the
    mean distance to the pivot, and a zoom by a factor of e have the distance 1."""
    if len(poses) < 2:
        return np.zeros(0)
    values = np.stack([_to_vector(pose) for pose in poses])
    unit = max(float(np.mean([pose.distance for pose in poses])), 1e-9)
    rotations = Rotation.from_matrix(np.stack([pose.rotation for pose in poses]))
    turns = (rotations[:-1].inv() * rotations[1:]).magnitude()
    moves = np.diff(values, axis=0)
    moves[:, :3] /= unit
    moves[:, 3] = 0  # The distance of the pivot does not change the image.
    return np.hypot(np.linalg.norm(moves, axis=1), turns)


def _to_vector(pose: Pose) -> Array:
    """Convert a pose to a vector (7,) without its rotation: eye, distance, field of view and offset. Distance and field
    of view are stored so that every value is valid."""
    zoom = np.log(np.tan(pose.field_of_view / 2))
    return np.array([*pose.eye, np.log(pose.distance), zoom, *pose.offset])


def _from_vector(vector: Array, rotation: Array, up: Array) -> Pose:
    distance, field_of_view = float(np.exp(vector[3])), float(2 * np.arctan(np.exp(vector[4])))
    pivot = vector[:3] + distance * rotation[2]
    return Pose(pivot, rotation, distance, field_of_view, up, (float(vector[5]), float(vector[6])))
