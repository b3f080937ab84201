"""Camera paths through a capture's surroundings; those that loop end where they begin.

Every path is a list of cameras, one a picture. A path that loops leaves out the last camera,
since it equals the first: played again and again it moves on without a stop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fourd.cameras import Camera, look_at
from fourd.viewer.navigation.up_direction import estimate_up

Array = NDArray[np.float64]
Bounds = tuple[Sequence[float], Sequence[float]]
PathKind = Literal["orbit", "spiral", "cameras"]

# A gap between neighbouring cameras wider than this means that the capture has a back nobody saw.
_WIDEST_GAP = np.radians(120)


def camera_path(
    kind: PathKind,
    cameras: Sequence[Camera],
    focus: Sequence[float] | Array | None,
    steps: int,
    *,
    size: tuple[int, int] | None = None,
) -> list[Camera]:
    """A looping path by its name: :func:`orbit`, :func:`spiral`, or "cameras": through the capture's in a ring."""
    if kind == "orbit":
        return orbit(cameras, steps, focus=focus, size=size)
    if kind == "spiral":
        return spiral(cameras, steps, focus=focus, size=size)
    return interpolate([cameras[index] for index in ring_order(cameras, focus)], steps, size=size)


def orbit(
    cameras: Sequence[Camera],
    steps: int,
    *,
    focus: Sequence[float] | Array | None = None,
    up: Sequence[float] | Array | None = None,
    distance: float | None = None,
    elevation: float | None = None,
    size: tuple[int, int] | None = None,
    full: bool | None = None,
) -> list[Camera]:
    """A circle around ``focus`` that begins beside the first camera and loops.

    Args:
        cameras: of the capture; at least 1.
        steps: number of pictures, at least 1.
        focus: (3,) point to settings at; None estimates it (:func:`estimate_focus`).
        up: (3,) the world's up; None estimates it (:func:`estimate_up`).
        distance: from the focus in world units; None for the cameras' median.
        elevation: degrees above the plane through the focus; None for the cameras' median.
        size: (width, height) in pixels; None for the first camera's.
        full: go all the way round, or swing to and fro over the arc that the cameras cover. None
            goes round unless the cameras leave a gap of more than 120 degrees.
    """
    stage = _stage(cameras, steps, focus, up)
    distance = stage.distance if distance is None else distance
    height = stage.elevation if elevation is None else np.radians(elevation)
    azimuths = _sweep(stage, steps, full)
    return [stage.camera(azimuth, height, distance, size) for azimuth in azimuths]


def spiral(
    cameras: Sequence[Camera],
    steps: int,
    *,
    focus: Sequence[float] | Array | None = None,
    up: Sequence[float] | Array | None = None,
    turns: int = 2,
    swing: float | None = None,
    size: tuple[int, int] | None = None,
    full: bool | None = None,
) -> list[Camera]:
    """Like :func:`orbit`, ``turns`` times round, rising and sinking once on the way; it loops.

    Args:
        turns: times round (or to and fro), at least 1.
        swing: degrees that the camera rises above and sinks below the median elevation; None for
            the range of the cameras themselves, at least 10.
    """
    if turns < 1:
        raise ValueError(f"turns: expected at least 1, got {turns}")
    stage = _stage(cameras, steps, focus, up)
    reach = max(stage.elevation_reach, np.radians(10)) if swing is None else np.radians(swing)
    phases = 2 * np.pi * np.arange(steps) / steps
    heights = np.clip(stage.elevation + reach * np.sin(phases), -np.radians(80), np.radians(80))
    azimuths = _sweep(stage, steps, full, turns)
    return [
        stage.camera(azimuth, height, stage.distance, size) for azimuth, height in zip(azimuths, heights, strict=True)
    ]


def interpolate(
    cameras: Sequence[Camera],
    steps: int,
    *,
    loop: bool = True,
    size: tuple[int, int] | None = None,
) -> list[Camera]:
    """A smooth flight through ``cameras`` in their order, which passes through each of them.

    Positions, orientations (quaternions), focal lengths and principal points follow cubic splines
    with continuous acceleration, at a nearly constant speed.

    Args:
        cameras: at least 1; neighbours that are equal count once.
        steps: number of pictures, at least 1.
        loop: fly back from the last to the first; without it the path ends at the last camera.
        size: (width, height) in pixels; None for the first camera's.
    """
    _check(cameras, steps)
    width, height = size or (cameras[0].width, cameras[0].height)
    fitted = [fit_camera(camera, width, height) for camera in cameras]
    knots = _distinct(np.stack([_packed(camera) for camera in fitted]), loop)
    if len(knots) == 1:
        return [fitted[0]] * steps
    values = _along(knots, steps, loop)
    return [_unpacked(value, width, height) for value in values]


def ring_order(cameras: Sequence[Camera], focus: Sequence[float] | Array | None = None) -> list[int]:
    """Indices of the cameras by their azimuth around ``focus``: an order for :func:`interpolate`.

    The order begins after the widest gap, so that an arc of cameras is flown from end to end.
    """
    stage = _stage(cameras, 1, focus, None)
    order = np.argsort(stage.azimuths, kind="stable")
    sorted_azimuths = stage.azimuths[order]
    gaps = np.diff(sorted_azimuths, prepend=sorted_azimuths[-1] - 2 * np.pi)
    return [int(index) for index in np.roll(order, -int(np.argmax(gaps)))]


def estimate_focus(cameras: Sequence[Camera], bounds: Bounds | None = None) -> Array:
    """(3,) the point nearest to all optical axes in the least-squares sense.

    Where the axes do not fix a point in front of the cameras (they are nearly parallel, or there
    is one camera), the centre of ``bounds`` (lower, upper) is taken; without bounds, a point ahead
    of the cameras by three times their spread (by 1 for a single camera).
    """
    centres = np.stack([camera.centre for camera in cameras])
    axes = np.stack([camera.forward for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal = across.sum(axis=0)
    if np.linalg.eigvalsh(normal)[0] > 1e-3 * len(cameras):
        focus = np.linalg.solve(normal, (across @ centres[:, :, None]).sum(axis=0)[:, 0])
        if np.mean(((focus - centres) * axes).sum(axis=1) > 0) > 0.5:
            return focus
    if bounds is not None:
        return (np.asarray(bounds[0], dtype=np.float64) + np.asarray(bounds[1])) / 2
    spread = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    return centres.mean(axis=0) + _unit(axes.mean(axis=0)) * (3 * spread if spread > 1e-9 else 1.0)


def fit_camera(camera: Camera, width: int, height: int) -> Camera:
    """The same view on an image of another size: nothing is stretched, the whole old image fits in."""
    zoom = min(width / camera.width, height / camera.height)
    intrinsics = np.diag([zoom, zoom, 1.0]) @ camera.intrinsics
    intrinsics[0, 2] += (width - zoom * camera.width) / 2
    intrinsics[1, 2] += (height - zoom * camera.height) / 2
    return Camera(intrinsics, camera.rotation, camera.translation, width, height)


@dataclass(frozen=True)
class _Stage:
    """The capture in cylinder terms: where its cameras stand around the focus."""

    focus: Array
    axes: Array
    azimuths: Array
    distance: float
    elevation: float
    elevation_reach: float
    zoom: float
    size: tuple[int, int]

    def camera(self, azimuth: float, elevation: float, distance: float, size: tuple[int, int] | None) -> Camera:
        width, height = size or self.size
        local = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
        centre = self.focus + distance * (np.asarray(local) @ self.axes)
        focal = self.zoom * min(width, height)
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        return look_at(centre, self.focus, self.axes[2], intrinsics, width, height)


def _stage(
    cameras: Sequence[Camera],
    steps: int,
    focus: Sequence[float] | Array | None,
    up: Sequence[float] | Array | None,
) -> _Stage:
    _check(cameras, steps)
    target = estimate_focus(cameras) if focus is None else np.asarray(focus, dtype=np.float64)
    upward = estimate_up(cameras) if up is None else _unit(np.asarray(up, dtype=np.float64))
    offsets = np.stack([camera.centre for camera in cameras]) - target
    level = offsets[0] - (offsets[0] @ upward) * upward
    if np.linalg.norm(level) < 1e-6 * max(float(np.linalg.norm(offsets[0])), 1e-6):
        level = np.cross(upward, np.eye(3)[np.argmin(np.abs(upward))])
    first = _unit(level)
    axes = np.stack([first, np.cross(upward, first), upward])
    local = offsets @ axes.T
    distances = np.maximum(np.linalg.norm(local, axis=1), 1e-9)
    elevations = np.arcsin(np.clip(local[:, 2] / distances, -1, 1))
    # Straight above the focus "up" would be along the view.
    middle = float(np.clip(np.median(elevations), -np.radians(80), np.radians(80)))
    zooms = [camera.intrinsics[1, 1] / min(camera.width, camera.height) for camera in cameras]
    return _Stage(
        focus=target,
        axes=axes,
        azimuths=np.arctan2(local[:, 1], local[:, 0]),
        distance=float(np.median(distances)),
        elevation=middle,
        elevation_reach=float(np.abs(elevations - middle).max()),
        zoom=float(np.median(zooms)),
        size=(cameras[0].width, cameras[0].height),
    )


def _sweep(stage: _Stage, steps: int, full: bool | None, turns: int = 1) -> Array:
    """(steps,) azimuths, round or to and fro."""
    phases = 2 * np.pi * turns * np.arange(steps) / steps
    ordered = np.sort(stage.azimuths)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    widest = int(np.argmax(gaps))
    if full is None:
        full = len(ordered) < 2 or bool(gaps[widest] <= _WIDEST_GAP)
    if full:
        return phases
    begin = ordered[(widest + 1) % len(ordered)]
    arc = 2 * np.pi - gaps[widest]
    return begin + arc / 2 + arc / 2 * np.sin(phases)


def _along(knots: Array, steps: int, loop: bool) -> Array:
    """(steps, D) values of the spline through ``knots`` (M, D), evenly along its length."""
    if loop:
        # Once round, the quaternions may come back with the other sign, which is the same rotation.
        # Twice round they are periodic for certain, and the first round is what is shown.
        knots = _one_sided(np.concatenate([knots, knots, knots[:1]]))
    else:
        knots = _one_sided(knots)
    lengths = np.maximum(_distances(knots[:-1], knots[1:]), 1e-9)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    if not loop:
        kind = "natural" if len(knots) > 2 else "not-a-knot"
        return CubicSpline(at, knots, bc_type=kind)(np.linspace(0, at[-1], steps))
    knots[-1] = knots[0]
    return CubicSpline(at, knots, bc_type="periodic")(np.arange(steps) / steps * at[-1] / 2)


def _packed(camera: Camera) -> Array:
    """(11,) centre, quaternion, log focal lengths, principal point."""
    k = camera.intrinsics
    quaternion = Rotation.from_matrix(camera.rotation).as_quat()
    return np.concatenate([camera.centre, quaternion, np.log([k[0, 0], k[1, 1]]), k[:2, 2]])


def _unpacked(value: Array, width: int, height: int) -> Camera:
    rotation = Rotation.from_quat(value[3:7]).as_matrix()
    focal = np.exp(value[7:9])
    intrinsics = np.array([[focal[0], 0, value[9]], [0, focal[1], value[10]], [0, 0, 1.0]])
    return Camera(intrinsics, rotation, -rotation @ value[:3], width, height)


def _one_sided(knots: Array) -> Array:
    """Flip quaternions so that neighbours lie on the same side: the short way round."""
    knots = knots.copy()
    for before, after in pairwise(knots):
        if before[3:7] @ after[3:7] < 0:
            after[3:7] *= -1
    return knots


def _distinct(knots: Array, loop: bool) -> Array:
    """Without knots that equal the one before."""
    before = np.roll(knots, 1, axis=0)
    scale = max(float(np.ptp(knots[:, :3], axis=0).max()), 1e-12)
    keep = _distances(before, knots) > 1e-6 * min(scale, 1.0)
    if not loop or not keep.any():
        keep[0] = True
    return knots[keep]


def _distances(first: Array, second: Array) -> Array:
    """Length of a step: of the centre, and a little of the turn, so that turning on the spot takes time."""
    turn = 1 - np.abs((first[:, 3:7] * second[:, 3:7]).sum(axis=1)).clip(max=1)
    moved = np.linalg.norm(first[:, :3] - second[:, :3], axis=1)
    return np.hypot(moved, np.sqrt(turn) * 0.1 * max(float(moved.mean()), 1e-3))


def _check(cameras: Sequence[Camera], steps: int) -> None:
    if not cameras:
        raise ValueError("cameras: expected at least 1, got none")
    if steps < 1:
        raise ValueError(f"steps: expected at least 1, got {steps}")


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
