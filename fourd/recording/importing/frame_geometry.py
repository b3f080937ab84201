"""Conversion of calibrations for videos whose frames are stretched, turned upright or scaled down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.capture.video import VideoIndex
from fourd.recording.import_choices import CalibratedFrames
from fourd.recording.importing.imported import ImportedCamera


def turn_camera(camera: Camera, degrees: int) -> Camera:
    """Return the camera that fits the image of ``camera`` after the image is turned counter-clockwise by ``degrees``.

    In an image that is W pixels wide, a turn by 90 degrees maps the pixel (x, y) to (y, W - x), and the camera
    coordinates (X, Y, Z) to (Y, -X, Z). Of OpenCV's distortion coefficients, the radial ones (k1 to k6) do not change.
    The tangential coefficients form the pair (p2, p1), and the thin prism coefficients form the pairs (s1, s3) and
    (s2, s4). Each pair is a vector in the image: its first coefficient belongs to the x axis, its second one to the y
    axis. A turn by 90 degrees maps each pair (a, b) to (b, -a).

    Raises:
        ValueError: if the camera has skew or a tilted sensor, or ``degrees`` is not a multiple of 90.
    """
    if degrees % 90:
        raise ValueError(f"degrees: expected a multiple of 90, got {degrees}")
    for _ in range(degrees % 360 // 90):
        camera = _quarter_turn(camera)
    return camera


def _quarter_turn(camera: Camera) -> Camera:
    k = camera.intrinsics
    distortion = camera.distortion
    if abs(k[0, 1]) > 1e-9 or (distortion is not None and np.any(distortion.ravel()[12:])):
        raise ValueError("expected a camera without skew and without a tilted sensor")
    intrinsics = np.array([[k[1, 1], 0, k[1, 2]], [0, k[0, 0], camera.width - k[0, 2]], [0, 0, 1]])
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    return replace(
        camera,
        intrinsics=intrinsics,
        rotation=turn @ camera.rotation,
        translation=turn @ camera.translation,
        width=camera.height,
        height=camera.width,
        distortion=None if distortion is None else _turn_distortion(distortion),
    )


def _turn_distortion(distortion: NDArray[np.float64]) -> NDArray[np.float64]:
    turned = distortion.copy()
    flat, given = turned.reshape(-1), distortion.reshape(-1)
    for x, y in ((3, 2), (8, 10), (9, 11)):
        if max(x, y) < len(given):
            flat[x], flat[y] = given[y], -given[x]
    return turned


def reduced_indices(indices: Mapping[str, VideoIndex], reduce: float) -> dict[str, VideoIndex]:
    """Return video indices that make the reader scale down all frames: width and height are multiplied by ``reduce``,
    in (0, 1]."""
    return {name: index if reduce == 1 else index.reduce(reduce) for name, index in indices.items()}


def match_calibrations(
    cameras: Sequence[ImportedCamera], indices: Mapping[str, VideoIndex], meant: CalibratedFrames, reduce: float
) -> tuple[tuple[ImportedCamera, ...], list[str]]:
    """Stretch, turn and scale down each calibration in the same way as the frames of its video.

    A video with non-square pixels is stretched to square pixels. If the calibrated images have the shape of the stored
    frames, the calibration is stretched too.

    A calibration belongs either to the stored frames of the video or to the turned frames, which OpenCV and video
    players show. If ``meant`` is "auto", the orientation (landscape or portrait) of the calibrated images decides. The
    calibration belongs to the stored frames if these have the same orientation as the calibrated images, and the turned
    frames have the other orientation. In all other cases, it belongs to the turned frames.

    Args:
        cameras: the source's cameras.
        indices: indices of the videos by camera name; their frames are already scaled down.
        meant: whether the calibrations belong to the stored or to the turned frames.
        reduce: factor in (0, 1] that multiplies width and height of the frames.

    Returns:
        The cameras with the changed calibrations, and notes for the user.

    Raises:
        UserError: if a calibration cannot be turned.
    """
    found, groups = [], dict[str, list[str]]()
    for camera in cameras:
        calibration, index = camera.calibration, indices.get(camera.name)
        if calibration is not None and index is not None:
            if index.aspect != 1:
                calibration, text = _stretched(calibration, index, reduce)
                groups.setdefault(text, []).append(camera.name)
            if index.turn:
                is_stored, reason = _is_for_stored(calibration, index, meant)
                text = f"the calibration belongs to {'the stored' if is_stored else 'the turned'} frames ({reason})"
                groups.setdefault(text + (", so it is turned too" if is_stored else ""), []).append(camera.name)
                calibration = _turned(camera.name, calibration, index.turn) if is_stored else calibration
            calibration = calibration if reduce == 1 else calibration.rescale(reduce)
        found.append(replace(camera, calibration=calibration))
    return tuple(found), [f"{', '.join(names)}: {text}" for text, names in groups.items()]


def _stretched(calibration: Camera, index: VideoIndex, reduce: float) -> tuple[Camera, str]:
    """Return the calibration of a video with non-square pixels for its stretched frames, and a note.

    A calibration whose images have the shape of the stored frames belongs to the stored frames, so it is stretched like
    them. This also applies if its focal lengths and its principal point are those of the stored frames, because a
    calibration without image size gets the size of the shown frames. Otherwise, it belongs to the frames as players
    show them, and is not changed.
    """
    shown = (round(index.unturned_size[0] / reduce), round(index.unturned_size[1] / reduce))
    stored = (index.stored_width, index.stored_height)
    size = (calibration.width, calibration.height)
    if index.turn % 180 != 0 and (size[0] > size[1]) != (shown[0] > shown[1]):
        shown, stored = shown[::-1], stored[::-1]
    x, y = shown[0] / stored[0], shown[1] / stored[1]
    k, text = calibration.intrinsics, f"its images are {size[0]} x {size[1]}"
    if abs(_log_ratio(size, stored)) < abs(_log_ratio(size, shown)):
        width, height = round(size[0] * x), round(size[1] * y)
    elif _has_stored_lens(k, size, x / y):
        (width, height), text = size, f"its focal lengths are {k[0, 0]:.5g} and {k[1, 1]:.5g}"
    else:
        return calibration, f"the calibration belongs to square pixels ({text}), so it is not stretched"
    stretched = replace(calibration, intrinsics=np.diag([x, y, 1.0]) @ k, width=width, height=height)
    return stretched, f"the calibration belongs to the stored pixels ({text}), so it is stretched too"


def _log_ratio(size: tuple[int, int], other: tuple[int, int]) -> float:
    """Return the logarithm of the ratio of two aspect ratios."""
    return float(np.log(size[0] / size[1] * other[1] / other[0]))


def _has_stored_lens(k: NDArray[np.float64], shown: tuple[int, int], aspect: float) -> bool:
    """Return whether intrinsics belong to stored pixels of the given aspect ratio instead of square pixels: both the
    ratio of the focal lengths and the principal point must say so."""
    ratio = np.log(k[0, 0] / k[1, 1])
    axis = 0 if aspect > 1 else 1
    centre, squeezed = shown[axis] / 2, shown[axis] / 2 / max(aspect, 1 / aspect)
    is_squeezed = abs(k[axis, 2] - squeezed) < abs(k[axis, 2] - centre)
    return bool(is_squeezed and abs(ratio + np.log(aspect)) < abs(ratio))


def _turned(name: str, calibration: Camera, turn: int) -> Camera:
    try:
        return turn_camera(calibration, turn)
    except ValueError as error:
        raise UserError(f"camera '{name}': {error}; calibrate the turned frames of its video") from error


def _is_for_stored(calibration: Camera, index: VideoIndex, meant: CalibratedFrames) -> tuple[bool, str]:
    """Return whether a calibration belongs to the stored frames of a turned video, and the reason."""
    if meant != "auto":
        return meant == "stored", f"--calibrated-frames {meant}"
    width, height = calibration.width, calibration.height
    stored_width, stored_height = index.unturned_size
    if index.turn % 180 == 0 or width == height or stored_width == stored_height:
        return False, "stored and turned frames have its orientation; change this with --calibrated-frames stored"
    is_stored = (width > height) == (stored_width > stored_height)
    return is_stored, f"its images are {width} x {height}"
