"""Time offsets between calibrated cameras without a common trigger, from the motion in common epipolar planes.

The planes through the centres of two cameras are their epipolar planes. Both cameras see a point in the same plane. The
motion energy of a whole image tells only when something moves; the motion energies of the planes also tell where, as
far as the other camera can know it. Their correlation is therefore high at the right lag, and low at lags at which
different parts of the scene move (Pundik and Moses, Video synchronization using temporal signals from epipolar lines,
ECCV 2010).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from fourd.base.cameras import Camera
from fourd.recording.sync.motion import (
    LAG_TOLERANCE_FRAMES,
    MAX_LAG_ERROR_FRAMES,
    MIN_OVERLAP,
    Grey,
    Offsets,
    moving_pixels,
)
from fourd.recording.sync.pairs import camera_confidence, find_peak, solve_offsets

Array = NDArray[np.float64]
Planes = NDArray[np.int64]

PLANES = 48
"""Number of groups into which the common planes of two cameras are divided, by angle."""
ANGLES = 360
"""Number of angles at which it is tested whether both cameras see a plane."""
RECORD_WIDTH_PX, MAX_HEIGHT_PX = 100, 600
"""Width in pixels at which motion is recorded, and the largest height: pixels are numbered by 16 bits."""
MAX_PIXELS = 1000
"""Maximum number of pixels of an image whose motion is recorded: those with the most motion. It bounds the memory."""
MAX_FRAMES = 3600
"""Maximum number of frames of a camera whose motion is recorded: 14 MB if all of it moves."""
MIN_FRAMES = 2 * MIN_OVERLAP
"""Minimum number of frames of each camera. In fewer frames, too few lags can be compared."""
STRIDES = (1, 2, 3, 5)
"""Of rigs with more than 9 cameras, only the pairs of cameras i and i + stride, counted in a circle, are compared."""
LEAD_WEIGHT, HEIGHT_WEIGHT = 4.0, 2.0
"""A pair's confidence is the smaller one of LEAD_WEIGHT times the lead of the peak of its correlation and HEIGHT_WEIGHT
times its height. With these values, 94 to 100% of the offsets with a confidence of 0.5 to 1 were right within 3 frames;
see docs/lab/calibration.md."""


@dataclass(frozen=True, eq=False)
class MotionRecord:
    """Where and when something moves in a camera's video.

    Attributes:
        energies: (F,) motion energy of each frame; see :func:`~fourd.recording.sync.motion.motion_energy`.
        width, height: size in pixels of the images in which the motion is recorded.
        pixels: for each of the first frames, at most MAX_FRAMES, the flat indices of the moving pixels.
        amounts: for each of these frames, the motion of these pixels in grey levels.
    """

    energies: Array
    width: int
    height: int
    pixels: tuple[NDArray[np.uint16], ...]
    amounts: tuple[NDArray[np.float16], ...]

    @staticmethod
    def of(pictures: Iterable[Grey]) -> MotionRecord:
        """Record the motion in grey images (H, W) uint8, which are read one after the other.

        Raises:
            ValueError: if the images differ in size.
        """
        energies: list[float] = []
        pixels: list[NDArray[np.uint16]] = []
        amounts: list[NDArray[np.float16]] = []
        size = (RECORD_WIDTH_PX, 1)
        for moving in moving_pixels(pictures):
            energies.append(float(moving.mean()))
            if len(pixels) < MAX_FRAMES:
                height = round(moving.shape[0] * RECORD_WIDTH_PX / moving.shape[1])
                size = (RECORD_WIDTH_PX, min(max(height, 1), MAX_HEIGHT_PX))
                flat = cv2.resize(moving, size, interpolation=cv2.INTER_AREA).ravel()
                found = np.flatnonzero(flat)
                if len(found) > MAX_PIXELS:
                    found = np.sort(np.argpartition(flat, -MAX_PIXELS)[-MAX_PIXELS:])
                pixels.append(found.astype(np.uint16))
                amounts.append(flat[found].astype(np.float16))
        if len(energies) > 1:
            # The first image has no previous one. Its motion is assumed to be that of the second image.
            energies[0], pixels[0], amounts[0] = energies[1], pixels[1], amounts[1]
        return MotionRecord(np.array(energies, np.float64), *size, tuple(pixels), tuple(amounts))

    def in_planes(self, planes: Planes) -> Array:
        """Return the motion (F, PLANES) in each group of planes, as the square root of its sum in grey levels.

        The square root reduces the weight of the few planes in which most of the motion is.

        Args:
            planes: (H * W,) the number of each pixel's group, or PLANES for pixels outside all groups.
        """
        rows = [
            np.bincount(planes[pixels], weights=amounts, minlength=PLANES + 1)[:PLANES]
            for pixels, amounts in zip(self.pixels, self.amounts, strict=True)
        ]
        return np.sqrt(np.array(rows, np.float64).reshape(-1, PLANES))


def estimate_epipolar_offsets(
    records: Sequence[MotionRecord], cameras: Sequence[Camera], max_offset: int
) -> Offsets | None:
    """Estimate the time offset of each camera relative to the first camera, from the motion in common epipolar planes.

    A pair's lag is where the correlation of the motion in all common planes is highest, after the mean of each plane is
    subtracted. The offsets are fitted to the lags as in :func:`~fourd.recording.sync.motion.estimate_offsets`. Unlike
    there, offsets of slow and smooth motion are exact to about a frame.

    A pair's confidence is ``min(4 * (p1 - p2), 2 * p1)``, where p1 is the peak of the correlation, and p2 the highest
    correlation at lags more than 3 frames away from the peak. It is 0 if the peak is at the end of the searched lags,
    if the lag differs by more than one frame from the difference of the two cameras' offsets, or if the cameras have no
    common planes. A camera's confidence is the mean of the better half of its pairs, but at most that of the first
    camera, on which all offsets depend. Cyclic motion has no unique lag, which gives it a low confidence, unless the
    searched lags are shorter than a cycle.

    Args:
        records: the motion in each camera's video.
        cameras: the cameras' calibrations, for images of any size of the records' shape. The world's unit is arbitrary.
        max_offset: maximum offset in frames. It is reduced to half of the frames of the shortest video.

    Returns:
        the offsets, or None if there are fewer than 2 cameras or fewer than MIN_FRAMES frames.
    """
    shortest = min((len(record.pixels) for record in records), default=0)
    if len(records) < 2 or shortest < MIN_FRAMES:
        return None
    max_lag = min(max_offset, shortest // 2)
    views = [camera.resize(record.width, record.height) for camera, record in zip(cameras, records, strict=True)]
    pairs = _compared_pairs(len(views))
    lags, weights = np.zeros(len(pairs)), np.zeros(len(pairs))
    for row, (i, j) in enumerate(pairs):
        planes = common_planes(views[i], views[j])
        if planes is not None:
            first, second = records[i].in_planes(planes[0]), records[j].in_planes(planes[1])
            lags[row], weights[row] = _estimate_lag(first, second, max_lag)
    solution = solve_offsets(pairs, lags, weights, len(views), LAG_TOLERANCE_FRAMES)
    agrees = [
        abs(solution[j] - solution[i] - lag) <= MAX_LAG_ERROR_FRAMES for (i, j), lag in zip(pairs, lags, strict=True)
    ]
    agreed = list(zip(weights * np.array(agrees), pairs, strict=True))
    own = [camera_confidence([weight for weight, pair in agreed if camera in pair]) for camera in range(len(views))]
    confidence = tuple(min(each, own[0]) for each in own)
    return Offsets(tuple(round(float(o)) for o in solution), tuple(map(float, solution)), confidence)


def _compared_pairs(count: int) -> list[tuple[int, int]]:
    if count <= 2 * max(STRIDES) - 1:
        return list(combinations(range(count), 2))
    others = [(i, (i + stride) % count) for i in range(count) for stride in STRIDES]
    return sorted({(min(pair), max(pair)) for pair in others})


def common_planes(first: Camera, second: Camera) -> tuple[Planes, Planes] | None:
    """Divide the epipolar planes that two cameras have in common into PLANES groups of equal angles.

    Each half-plane that ends at the line through the two centres has an angle around this line. A point has the same
    angle for both cameras.

    Returns:
        For each camera, the numbers (H * W,) of the groups to which its pixels belong, or PLANES for pixels in planes
        that the other camera does not see. The result is None if the cameras have the same centre or no common planes.
    """
    axis = second.centre - first.centre
    length = float(np.linalg.norm(axis))
    if length < 1e-9 * (1 + float(np.abs(first.centre).max())):
        return None
    axis = axis / length
    # Angles jump by a full turn opposite to the direction of angle 0, so this direction is the viewing direction.
    ahead = first.forward + second.forward
    ahead = ahead - axis * (axis @ ahead)
    if np.linalg.norm(ahead) < 1e-3:
        ahead = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    ahead = ahead / np.linalg.norm(ahead)
    side = np.cross(axis, ahead)
    angles = [np.arctan2(rays @ side, rays @ ahead) for rays in (_pixel_rays(first), _pixel_rays(second))]
    seen = [np.histogram(each, bins=ANGLES, range=(-np.pi, np.pi))[0] > 0 for each in angles]
    both = np.flatnonzero(seen[0] & seen[1])
    if len(both) == 0:
        return None
    low, high = (2 * np.pi * edge / ANGLES - np.pi for edge in (both[0], both[-1] + 1))
    groups = [np.floor((each - low) / (high - low) * PLANES).astype(np.int64) for each in angles]
    inside = [np.where((group >= 0) & (group < PLANES), group, PLANES) for group in groups]
    return inside[0], inside[1]


def _pixel_rays(camera: Camera) -> Array:
    """Return the directions (H * W, 3), in world coordinates, in which the camera sees its pixels."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    if camera.distortion is not None:
        ideal = cv2.undistortPoints(pixels[:, None], camera.intrinsics, camera.distortion, P=camera.intrinsics)
        pixels = np.asarray(ideal, np.float64)[:, 0]
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.intrinsics).T
    return np.asarray(rays @ camera.rotation, np.float64)


def _estimate_lag(first: Array, second: Array, max_lag: int) -> tuple[float, float]:
    """Find the lag at which ``second[f + lag]`` correlates best with ``first[f]``, and the pair's confidence."""
    peak = find_peak(plane_correlations(first, second, max_lag))
    if peak.index in (0, 2 * max_lag):
        return peak.position - max_lag, 0.0
    return peak.position - max_lag, float(np.clip(min(LEAD_WEIGHT * peak.lead, HEIGHT_WEIGHT * peak.height), 0, 1))


def plane_correlations(first: Array, second: Array, max_lag: int) -> Array:
    """Compute the correlations (2 * max_lag + 1,) of ``second[f + lag]`` with ``first[f]`` for the lags from -max_lag
    to max_lag, over the frames in which both have values. The mean of each plane in these frames is subtracted.

    Args:
        first, second: motion (F, PLANES) in the common planes of two cameras. F may differ.
        max_lag: maximum lag in frames, less than both F.
    """
    lags = np.arange(-max_lag, max_lag + 1)
    start, end = np.maximum(0, -lags), np.minimum(len(first), len(second) - lags)
    count = end - start
    size = next_fast_len(len(first) + len(second), real=True)
    spectrum = (np.conj(rfft(first, size, axis=0)) * rfft(second, size, axis=0)).sum(axis=1)
    products = np.asarray(irfft(spectrum, size), np.float64)[lags % size]
    sums = [_range_sums(first, start, end), _range_sums(second, start + lags, end + lags)]
    powers = [
        _range_sums((signal**2).sum(axis=1, keepdims=True), begin, stop)[:, 0]
        for signal, begin, stop in ((first, start, end), (second, start + lags, end + lags))
    ]
    covariance = products - (sums[0] * sums[1]).sum(axis=1) / count
    variances = [power - (total**2).sum(axis=1) / count for power, total in zip(powers, sums, strict=True)]
    norm = np.sqrt(np.maximum(variances[0], 0) * np.maximum(variances[1], 0))
    # Rounding leaves a small variance where nothing moves.
    floor = 1e-6 * np.sqrt(float((first**2).sum()) * float((second**2).sum()))
    return np.where(norm > floor, covariance / np.maximum(norm, 1e-300), 0.0)


def _range_sums(values: Array, start: NDArray[np.int64], end: NDArray[np.int64]) -> Array:
    """Return the sums (L, P) of the rows ``start[l]`` to ``end[l] - 1`` of ``values`` (F, P)."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    return np.asarray(total[end] - total[start], np.float64)
