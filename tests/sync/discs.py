"""Images of discs that move smoothly in front of calibrated cameras."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fourd.base.cameras import Camera
from fourd.recording.capture import write_calibration
from tests.captures import ring_cameras

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]
SIZE = 96


def smooth_paths(rng: np.random.Generator, frames: int, discs: int = 3) -> Array:
    """Paths (frames, discs, 3) of discs that move smoothly inside a ball."""
    steps = gaussian_filter1d(rng.normal(size=(frames + 40, discs, 3)), 6, axis=0)[20 : frames + 20]
    return np.asarray(0.45 * steps / np.abs(steps).max(), np.float64)


def film(camera: Camera, paths: Array, rng: np.random.Generator) -> list[Grey]:
    """Images of discs on a noisy background. The sensor's noise differs from frame to frame."""
    backdrop = gaussian_filter1d(rng.uniform(60, 140, (camera.height, camera.width)), 2, axis=1)
    pictures = []
    for centres in paths:
        picture = backdrop.copy()
        pixels, depth = camera.project(centres)
        for (x, y), z, level in zip(pixels, depth, (250, 20, 210), strict=False):
            radius = max(1, round(0.12 * camera.intrinsics[0, 0] / z))
            cv2.circle(picture, (round(float(x)), round(float(y))), radius, float(level), -1)
        pictures.append(np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8))
    return pictures


def write_disc_videos(
    folder: Path, names: Sequence[str], offsets: Sequence[int], frames: int, rng: np.random.Generator
) -> Path:
    """Write calibrated videos of ``frames`` frames in EasyMocap's layout. Each event appears ``offsets`` frames later
    than in a video with the offset 0."""
    cameras, most = ring_cameras(len(names), SIZE), max(offsets)
    paths = smooth_paths(rng, frames + most - min(offsets))
    write_calibration(folder, names, cameras)
    (folder / "videos").mkdir()
    for name, camera, offset in zip(names, cameras, offsets, strict=True):
        start = most - offset
        with av.open(str(folder / "videos" / f"{name}.mp4"), "w") as container:
            stream = container.add_stream("libx264", rate=30, options={"crf": "12"})
            stream.width, stream.height, stream.pix_fmt = SIZE, SIZE, "yuv420p"
            for number, picture in enumerate(film(camera, paths[start : start + frames], rng)):
                frame = av.VideoFrame.from_ndarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB), format="rgb24")
                frame.pts, frame.time_base = number, Fraction(1, 30)
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
    return folder
