"""Clean plates: each camera's background without the subject.

A plate is the mean of a camera's frames over time, as in 4K4D, sec. 4.1. The weight of a pixel in this mean is 1 minus
the dilated matte, so pixels that show the subject are excluded. The computation differs from 4K4D in three ways. The
mean is a running mean, which needs constant memory. The exposure of each frame is matched to the first frame. A second
pass excludes pixels that differ too much from the mean of the first pass, because the matte has probably missed the
subject there.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.files import remove_unfinished, write_text_atomically
from fourd.base.formats.picture import write_picture
from fourd.base.limits import open_regular, read_json
from fourd.base.parallel import run_jobs
from fourd.base.progress import Track
from fourd.recording.capture import Capture
from fourd.recording.capture.layout import MATTES, refuse_symlinks, sample_indices
from fourd.recording.matting.selection import Selection

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

FOLDER = Path(".fourd") / "plates"
STATE = "plates.json"
MAX_FRAMES = 64
"""Maximum number of averaged frames. The mean of 64 frames has an eighth of the noise of one frame."""
MARGIN = 1 / 150
"""Width of the excluded band around the matte, as a fraction of the image's longest side.

The band covers the matte's soft edge and shadows next to the subject.
"""
OUTLIER_STDS = 3.0
MIN_OUTLIER_DISTANCE = 6.0
MIN_WEIGHT = 1.0
"""Minimum sum of a pixel's background weights over all averaged frames. Pixels with a smaller sum are holes: their
background is unknown."""
INPAINT_PX = 5


@dataclass(frozen=True, eq=False)
class Plate:
    """A camera's background.

    Attributes:
        rgb: (H, W, 3) uint8; holes are inpainted for display.
        seen: (H, W) bool, False in holes, which the subject covers in all frames.
    """

    rgb: Picture
    seen: NDArray[np.bool_]


@dataclass
class _RunningStatistics:
    """Weighted mean and standard deviation of the colours of each pixel."""

    shape: tuple[int, int]
    weight: Floats = field(init=False)
    mean: Floats = field(init=False)
    squares: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.weight = np.zeros(self.shape, np.float32)
        self.mean = np.zeros((*self.shape, 3), np.float32)
        self.squares = np.zeros((*self.shape, 3), np.float32)

    def add(self, value: Floats, weight: Floats) -> None:
        """Add a frame (H, W, 3) with weights (H, W), using West's incremental update (1979)."""
        self.weight += weight
        share = np.divide(weight, self.weight, out=np.zeros_like(weight), where=self.weight > 0)[..., None]
        delta = value - self.mean
        self.mean += share * delta
        self.squares += weight[..., None] * delta * (value - self.mean)

    @property
    def std(self) -> Floats:
        """Standard deviation (H, W) of each pixel's colour over the frames, pooled over the colour channels."""
        return np.sqrt(self.squares.mean(axis=-1) / np.maximum(self.weight, 1e-6))


def make_plates(selection: Selection, key: str, workers: int, track: Track, folder: Path | None = None) -> int:
    """Write the plate of each camera as ``folder/CAM.png``: undistorted RGBA with alpha 0 in holes.

    Plates from an earlier call with the same ``key`` and the same mattes are kept.

    Args:
        selection: the capture.
        key: hash of the inputs of the mattes.
        workers: number of processes; each process computes one camera at a time.
        track: progress callback.
        folder: output folder, or None for ``.fourd/plates`` in the capture's folder.

    Returns:
        The number of plates that this call wrote.

    Raises:
        UserError: if the capture has no mattes.
    """
    capture = selection.open()
    folder = folder or capture.path / FOLDER
    refuse_symlinks(capture.path, folder)
    remove_unfinished(folder)
    state = folder.parent / STATE
    try:
        done = dict(read_json(state))
    except (OSError, ValueError, TypeError):
        done = {}
    keys = {name: _camera_key(capture, name, key) for name in capture.names}
    missing = [name for name in capture.names if done.get(name) != keys[name] or not (folder / f"{name}.png").exists()]
    jobs = [_Job(selection, name, folder) for name in missing]
    for name in track(run_jobs(_make_plate, jobs, workers), len(jobs), "plates"):
        done[name] = keys[name]
        write_text_atomically(state, json.dumps(done, sort_keys=True) + "\n")
    return len(missing)


def _camera_key(capture: Capture, name: str, key: str) -> str:
    """Hash ``key`` and the matte files from which the camera's plate is computed.

    The contents of the matte files are hashed, because users may edit mattes.
    """
    digest = hashlib.sha256(key.encode())
    for frame in sample_indices(capture.frame_count, MAX_FRAMES):
        for folder in (Path("masks"), MATTES):
            matte = capture.path / folder / name / f"{capture.frame_names[frame]}.png"
            if matte.exists():
                with open_regular(matte) as stream:
                    digest.update(hashlib.file_digest(stream, hashlib.sha256).digest())
    return digest.hexdigest()


@dataclass(frozen=True)
class _Job:
    """A job for a worker process: the plate of one camera."""

    selection: Selection
    name: str
    folder: Path


def _make_plate(job: _Job) -> Iterator[str]:
    """Write one camera's plate, then yield the camera's name."""
    with replace(job.selection, views=(job.name,)).open() as capture:
        write_plate(job.folder / f"{job.name}.png", clean_plate(capture, 0))
    yield job.name


def clean_plate(capture: Capture, index: int) -> Plate:
    """Compute the plate of one camera from its images and mattes.

    Raises:
        UserError: if the capture has no mattes.
    """
    camera = capture.cameras[index]
    shape = (camera.height, camera.width)
    first = _RunningStatistics(shape)
    for value, weight in _weighted_frames(capture, index):
        first.add(value, weight)
    second = _RunningStatistics(shape)
    threshold = np.maximum(MIN_OUTLIER_DISTANCE, OUTLIER_STDS * first.std)
    for value, weight in _weighted_frames(capture, index):
        second.add(value, weight * (np.abs(value - first.mean).max(axis=-1) < threshold))
    seen = second.weight >= MIN_WEIGHT
    rgb = np.clip(np.where(seen[..., None], second.mean, first.mean) + 0.5, 0, 255).astype(np.uint8)
    filled = cv2.inpaint(rgb, (~seen).astype(np.uint8), INPAINT_PX, cv2.INPAINT_TELEA) if not seen.all() else rgb
    return Plate(np.asarray(filled, np.uint8), seen)


def write_plate(path: Path, plate: Plate) -> None:
    """Write a plate atomically as an RGBA PNG."""
    alpha = np.where(plate.seen, 255, 0).astype(np.uint8)
    write_picture(path, np.dstack([plate.rgb[..., ::-1], alpha]))


def _weighted_frames(capture: Capture, index: int) -> Iterator[tuple[Floats, Floats]]:
    """Yield frames (H, W, 3) scaled to the first frame's exposure, with per-pixel background weights (H, W)."""
    camera = capture.cameras[index]
    margin = max(1, round(MARGIN * max(camera.width, camera.height)))
    square = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1, 2 * margin + 1))
    reference: Picture | None = None
    for frame in sample_indices(capture.frame_count, MAX_FRAMES):
        rgb = capture.image(index, frame)
        weight = (1 - cv2.dilate(capture.mask(index, frame), square) / np.float32(255)).astype(np.float32)
        reference = rgb if reference is None else reference
        yield (rgb * _exposure_gain(rgb, reference, weight)).astype(np.float32), weight


def _exposure_gain(rgb: Picture, reference: Picture, weight: Floats) -> Floats:
    """Return the gains (3,), one per colour channel, that match the brightness of the frame ``rgb`` to the frame
    ``reference``. They are computed from the pixels that show the background in ``rgb``."""
    step = max(1, max(rgb.shape) // 256)
    part, other, free = rgb[::step, ::step], reference[::step, ::step], weight[::step, ::step] > 0.99
    free &= (part.min(axis=-1) > 16) & (other.max(axis=-1) < 250) & (part.max(axis=-1) < 250)
    if np.count_nonzero(free) < 100:
        return np.ones(3, np.float32)
    gain = np.median(other[free].astype(np.float32) / part[free], axis=0)
    # Gains within 0.004 of 1 are replaced by 1, because they do not indicate a change of exposure: rounding the images
    # to 8 bits moves the median ratio by up to this amount.
    return np.where(np.abs(gain - 1) < 0.004, 1, gain).astype(np.float32)
