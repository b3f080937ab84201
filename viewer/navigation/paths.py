"""Camera paths around a captured scene.

A path is a list of cameras, one per image. A looping path ends one step before its first camera, because a repeated
first image would look like a pause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fourd.base.cameras import Camera, estimate_up, look_at
from fourd.viewer.navigation.placement import frame_subject, keep_in_room

if TYPE_CHECKING:
    from fourd.scene.playable import Bounds

Array = NDArray[np.float64]
PathKind = Literal["orbit", "spiral", "cameras"]

_MAX_GAP = np.radians(120)
"""The cameras count as a full circle only if the azimuths of neighbouring cameras differ by at most this angle, in
radians.

Across a larger gap, no camera observes the side of the scene between the two cameras.
"""


def camera_path(
    kind: PathKind,
    cameras: Sequence[Camera],
    focus: Sequence[float] | Array | None,
    steps: int,
    *,
    size: tuple[int, int] | None = None,
    is_whole: bool = False,
    bounds: Bounds | None = None,
) -> list[Camera]:
    """Call :func:`orbit`, :func:`spiral` or :func:`interpolate`, depending on ``kind``, and return the looping path.

    A path of the kind "cameras" goes through all cameras in order of azimuth. If ``is_whole`` is true, the scene has
    surroundings, and the paths around the focus stay in the room; see
    :func:`~fourd.viewer.navigation.placement.keep_in_room`. Otherwise, ``bounds``, the box (lower, upper) of the
    subject, brings these paths nearer to a small subject; see
    :func:`~fourd.viewer.navigation.placement.frame_subject`.
    """
    if kind != "cameras":
        around = orbit if kind == "orbit" else spiral
        path = around(cameras, steps, focus=focus, size=size)
        centre = estimate_focus(cameras) if focus is None else focus
        if is_whole:
            return keep_in_room(path, cameras, centre)
        return path if bounds is None else frame_subject(path, centre, bounds)
    return interpolate([cameras[index] for index in order_by_azimuth(cameras, focus)], steps, size=size)


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
    """Return a looping circular path around ``focus``. A full circle starts at the azimuth of the first camera.

    Args:
        cameras: cameras of the capture; at least 1.
        steps: number of images, at least 1.
        focus: centre of the circle (3,) in world units, or None for the result of :func:`estimate_focus`.
        up: up direction (3,), or None for the result of :func:`estimate_up`.
        distance: distance from the focus in world units, or None for the cameras' median distance.
        elevation: degrees above the horizontal plane through the focus, or None for the cameras' median elevation.
        size: width and height of the images in pixels, or None for the size of the first camera.
        full: True for a full circle, or False for a path that swings back and forth over the arc of the cameras. If
            ``full`` is None, the path is a full circle unless the azimuths of two neighbouring cameras differ by more
            than 120 degrees.
    """
    rig = _measure_rig(cameras, steps, focus, up)
    distance = rig.distance if distance is None else distance
    angle = rig.elevation if elevation is None else np.radians(elevation)
    azimuths = _path_azimuths(rig, steps, full)
    return [rig.camera(azimuth, angle, distance, size) for azimuth in azimuths]


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
    """Return a looping path of several turns, along which the camera's elevation follows one period of a sine.

    The arguments that ``Args`` does not list have the same meaning as in :func:`orbit`.

    Args:
        turns: number of full circles, or of swings back and forth over the arc; at least 1.
        swing: amplitude, in degrees, of the elevation around the cameras' median elevation. If ``swing`` is None, the
            amplitude is the largest difference between a camera's elevation and the median, but at least 10 degrees.
    """
    if turns < 1:
        raise ValueError(f"turns: expected at least 1, got {turns}")
    rig = _measure_rig(cameras, steps, focus, up)
    amplitude = max(rig.elevation_deviation, np.radians(10)) if swing is None else np.radians(swing)
    phases = 2 * np.pi * np.arange(steps) / steps
    elevations = np.clip(rig.elevation + amplitude * np.sin(phases), -np.radians(80), np.radians(80))
    azimuths = _path_azimuths(rig, steps, full, turns)
    angles = zip(azimuths, elevations, strict=True)
    return [rig.camera(azimuth, elevation, rig.distance, size) for azimuth, elevation in angles]


def interpolate(
    cameras: Sequence[Camera],
    steps: int,
    *,
    loop: bool = True,
    size: tuple[int, int] | None = None,
) -> list[Camera]:
    """Return a smooth path through ``cameras`` in the given order.

    Positions, orientations (quaternions), focal lengths and principal points follow cubic splines with continuous
    second derivatives. The speed along the path is nearly constant.

    Args:
        cameras: cameras to pass through; at least 1. Equal cameras in succession count once.
        steps: number of images, at least 1.
        loop: if True, the path returns from the last camera to the first; otherwise it ends at the last camera.
        size: width and height of the images in pixels, or None for the size of the first camera.
    """
    _check_arguments(cameras, steps)
    width, height = size or (cameras[0].width, cameras[0].height)
    fitted = [fit_camera(camera, width, height) for camera in cameras]
    knots = _drop_duplicates(np.stack([_to_vector(camera) for camera in fitted]), loop)
    if len(knots) == 1:
        return [fitted[0]] * steps
    vectors = _sample_spline(knots, steps, loop)
    return [_from_vector(vector, width, height) for vector in vectors]


def order_by_azimuth(cameras: Sequence[Camera], focus: Sequence[float] | Array | None = None) -> list[int]:
    """Return the indices of the cameras, sorted by azimuth around ``focus``, for :func:`interpolate`.

    The order starts after the widest gap in azimuth, so that a path through an arc of cameras follows the arc.
    """
    rig = _measure_rig(cameras, 1, focus, None)
    order = np.argsort(rig.azimuths, kind="stable")
    sorted_azimuths = rig.azimuths[order]
    gaps = np.diff(sorted_azimuths, prepend=sorted_azimuths[-1] - 2 * np.pi)
    return [int(index) for index in np.roll(order, -int(np.argmax(gaps)))]


def estimate_focus(cameras: Sequence[Camera], bounds: Bounds | None = None) -> Array:
    """Return the least-squares intersection (3,) of all optical axes or, if it is not reliable, a substitute point.

    The intersection is not reliable if the axes are nearly parallel, if there is only one camera, or if the
    intersection lies behind at least half of the cameras. The substitute is the centre of ``bounds`` (lower, upper) or,
    if ``bounds`` is None, a point in front of the cameras along their mean viewing direction. The distance of this
    point from the mean camera centre is three times the largest distance of a camera centre from the mean, or 1 world
    unit for a single camera.
    """
    centres = np.stack([camera.centre for camera in cameras])
    axes = np.stack([camera.forward for camera in cameras])
    projections = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal = projections.sum(axis=0)
    if np.linalg.eigvalsh(normal)[0] > 1e-3 * len(cameras):
        focus = np.linalg.solve(normal, (projections @ centres[:, :, None]).sum(axis=0)[:, 0])
        if np.mean(((focus - centres) * axes).sum(axis=1) > 0) > 0.5:
            return focus
    if bounds is not None:
        return (np.asarray(bounds[0], dtype=np.float64) + np.asarray(bounds[1])) / 2
    spread = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    return centres.mean(axis=0) + _unit(axes.mean(axis=0)) * (3 * spread if spread > 1e-9 else 1.0)


def fit_camera(camera: Camera, width: int, height: int) -> Camera:
    """Change a camera's image size without distortion or cropping.

    The new image contains the whole old image, scaled and centred.
    """
    zoom = min(width / camera.width, height / camera.height)
    intrinsics = np.diag([zoom, zoom, 1.0]) @ camera.intrinsics
    intrinsics[0, 2] += (width - zoom * camera.width) / 2
    intrinsics[1, 2] += (height - zoom * camera.height) / 2
    return Camera(intrinsics, camera.rotation, camera.translation, width, height)


@dataclass(frozen=True)
class _Rig:
    """The cameras in spherical coordinates around the focus.

    Attributes:
        focus: origin of the spherical coordinates (3,), in world units.
        axes: unit vectors as the rows of a (3, 3) matrix. The first row is horizontal and points towards the azimuth
            of the first camera. The third row points up. The second row is the first row turned by 90 degrees,
            counterclockwise as seen from above.
        azimuths: azimuths of the cameras in radians, (C,).
        distance: the cameras' median distance from the focus in world units.
        elevation: the cameras' median elevation in radians.
        elevation_deviation: largest difference between a camera's elevation and the median elevation, in radians.
        zoom: the cameras' median focal length, in units of the shorter image side.
        size: width and height of the first camera's image in pixels.
    """

    focus: Array
    axes: Array
    azimuths: Array
    distance: float
    elevation: float
    elevation_deviation: float
    zoom: float
    size: tuple[int, int]

    def camera(self, azimuth: float, elevation: float, distance: float, size: tuple[int, int] | None) -> Camera:
        width, height = size or self.size
        local = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
        centre = self.focus + distance * (np.asarray(local) @ self.axes)
        focal = self.zoom * min(width, height)
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        return look_at(centre, self.focus, self.axes[2], intrinsics, width, height)


def _measure_rig(
    cameras: Sequence[Camera],
    steps: int,
    focus: Sequence[float] | Array | None,
    up: Sequence[float] | Array | None,
) -> _Rig:
    _check_arguments(cameras, steps)
    target = estimate_focus(cameras) if focus is None else np.asarray(focus, dtype=np.float64)
    up_axis = estimate_up(cameras) if up is None else _unit(np.asarray(up, dtype=np.float64))
    offsets = np.stack([camera.centre for camera in cameras]) - target
    horizontal = offsets[0] - (offsets[0] @ up_axis) * up_axis
    if np.linalg.norm(horizontal) < 1e-6 * max(float(np.linalg.norm(offsets[0])), 1e-6):
        horizontal = np.cross(up_axis, np.eye(3)[np.argmin(np.abs(up_axis))])
    first = _unit(horizontal)
    axes = np.stack([first, np.cross(up_axis, first), up_axis])
    local = offsets @ axes.T
    distances = np.maximum(np.linalg.norm(local, axis=1), 1e-9)
    elevations = np.arcsin(np.clip(local[:, 2] / distances, -1, 1))
    # The elevation is clamped to 80 degrees, because at 90 degrees the view direction would be parallel to the up
    # direction.
    median = float(np.clip(np.median(elevations), -np.radians(80), np.radians(80)))
    zooms = [camera.intrinsics[1, 1] / min(camera.width, camera.height) for camera in cameras]
    return _Rig(
        focus=target,
        axes=axes,
        azimuths=np.arctan2(local[:, 1], local[:, 0]),
        distance=float(np.median(distances)),
        elevation=median,
        elevation_deviation=float(np.abs(elevations - median).max()),
        zoom=float(np.median(zooms)),
        size=(cameras[0].width, cameras[0].height),
    )


def _path_azimuths(rig: _Rig, steps: int, full: bool | None, turns: int = 1) -> Array:
    """Return the azimuth of each image of a path in radians, (steps,). The path consists of full circles, or of swings
    back and forth over the arc that the cameras cover."""
    phases = 2 * np.pi * turns * np.arange(steps) / steps
    ordered = np.sort(rig.azimuths)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    widest = int(np.argmax(gaps))
    if full is None:
        full = len(ordered) < 2 or bool(gaps[widest] <= _MAX_GAP)
    if full:
        return phases
    start = ordered[(widest + 1) % len(ordered)]
    arc = 2 * np.pi - gaps[widest]
    return start + arc / 2 + arc / 2 * np.sin(phases)


def _sample_spline(knots: Array, steps: int, loop: bool) -> Array:
    """Sample the spline through ``knots`` at equal distances along the spline.

    ``knots`` (M, D) contains one camera vector per row. The samples have the shape (steps, D).
    """
    if loop:
        # After one loop around the cameras, the quaternion of the same rotation can have the opposite sign, so a
        # periodic spline over one loop would not close. After two loops, the quaternion has the same sign as at the
        # start. The spline therefore covers two loops, and only the first one is sampled.
        knots = _align_signs(np.concatenate([knots, knots, knots[:1]]))
    else:
        knots = _align_signs(knots)
    lengths = np.maximum(_distances(knots[:-1], knots[1:]), 1e-9)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    if not loop:
        kind: Literal["natural", "not-a-knot"] = "natural" if len(knots) > 2 else "not-a-knot"
        return CubicSpline(at, knots, bc_type=kind)(np.linspace(0, at[-1], steps))
    knots[-1] = knots[0]
    return CubicSpline(at, knots, bc_type="periodic")(np.arange(steps) / steps * at[-1] / 2)


def _to_vector(camera: Camera) -> Array:
    """Convert a camera to a vector (11,): centre, quaternion, log focal lengths and principal point."""
    k = camera.intrinsics
    quaternion = Rotation.from_matrix(camera.rotation).as_quat()
    return np.concatenate([camera.centre, quaternion, np.log([k[0, 0], k[1, 1]]), k[:2, 2]])


def _from_vector(vector: Array, width: int, height: int) -> Camera:
    """Convert a vector of :func:`_to_vector` to a camera. The quaternion in ``vector`` can have any length above 0."""
    rotation = Rotation.from_quat(vector[3:7]).as_matrix()
    focal = np.exp(vector[7:9])
    intrinsics = np.array([[focal[0], 0, vector[9]], [0, focal[1], vector[10]], [0, 0, 1.0]])
    return Camera(intrinsics, rotation, -rotation @ vector[:3], width, height)


def _align_signs(knots: Array) -> Array:
    """Negate quaternions so that consecutive quaternions have a positive dot product.

    With positive dot products, the spline interpolates along the shorter rotation.
    """
    knots = knots.copy()
    for previous, current in pairwise(knots):
        if previous[3:7] @ current[3:7] < 0:
            current[3:7] *= -1
    return knots


def _drop_duplicates(knots: Array, loop: bool) -> Array:
    """Drop each knot that is equal to the previous knot."""
    previous = np.roll(knots, 1, axis=0)
    scale = max(float(np.ptp(knots[:, :3], axis=0).max()), 1e-12)
    keep = _distances(previous, knots) > 1e-6 * min(scale, 1.0)
    if not loop or not keep.any():
        keep[0] = True
    return knots[keep]


def _distances(first: Array, second: Array) -> Array:
    """Return the length of each step between two successive knots.

    The length combines translation and rotation, so that a pure rotation also takes time.
    """
    turn = 1 - np.abs((first[:, 3:7] * second[:, 3:7]).sum(axis=1)).clip(max=1)
    moved = np.linalg.norm(first[:, :3] - second[:, :3], axis=1)
    return np.hypot(moved, np.sqrt(turn) * 0.1 * max(float(moved.mean()), 1e-3))


def _check_arguments(cameras: Sequence[Camera], steps: int) -> None:
    if not cameras:
        raise ValueError("cameras: expected at least 1, got none")
    if steps < 1:
        raise ValueError(f"steps: expected at least 1, got {steps}")


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
