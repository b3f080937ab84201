"""Sampling of a few reduced frames of all cameras for learning."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.capture import Capture
from fourd.capture.layout import sample_indices
from fourd.progress import Track

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

MAX_FRAMES = 24
MAX_PIXELS = 32 << 20
"""Total over all cameras and frames: 100 MB of pictures and twice as much of derived data."""

MAX_SIDE_PX = 512
MAX_STEP = 4
"""Maximum frame distance for optical flow: 67 ms at 60 frames per second."""


@dataclass(frozen=True, eq=False)
class CameraSample:
    """One camera's sampled frames.

    Attributes:
        camera: camera of the reduced pictures.
        rgb: (T, h, w, 3) uint8.
        motion_px: (T, h, w) float16 length of the optical flow to a neighbouring frame, reduced pixels.
    """

    camera: Camera
    rgb: Picture
    motion_px: NDArray[np.float16]


def sample_capture(capture: Capture, track: Track) -> list[CameraSample]:
    """Sample evenly spaced frames of all cameras at one scale."""
    frames = learning_frames(capture.frame_count)
    scale = _scale(capture.cameras, len(frames))
    samples = []
    for index in track(range(len(capture.cameras)), len(capture.cameras), "sampling"):
        camera = capture.cameras[index].rescale(scale)
        rgb = np.empty((len(frames), camera.height, camera.width, 3), np.uint8)
        motion = np.zeros((len(frames), camera.height, camera.width), np.float16)
        for row, frame in enumerate(frames):
            rgb[row] = reduce_picture(capture.image(index, frame), camera)
            other = flow_frame(frame, capture.frame_count)
            if other is not None:
                motion[row] = flow_length_px(rgb[row], reduce_picture(capture.image(index, other), camera))
        samples.append(CameraSample(camera, rgb, motion))
    return samples


def flow_frame(frame: int, count: int) -> int | None:
    """The second frame of the optical flow at ``frame`` of ``count``; None for a single frame."""
    step = min(MAX_STEP, max(1, count // MAX_FRAMES))
    other = frame + step if frame + step < count else frame - step
    return other if other >= 0 else None


def learning_frames(count: int) -> list[int]:
    """The frames, of ``count``, from which the subject is learned."""
    return sample_indices(count, MAX_FRAMES)


def reduce_picture(picture: Picture, camera: Camera) -> Picture:
    """Reduce a picture (H, W[, C]) to ``camera``'s size by area averaging."""
    if picture.shape[:2] == (camera.height, camera.width):
        return picture
    return np.asarray(cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA), np.uint8)


def flow_length_px(before: Picture, after: Picture) -> Floats:
    """(H, W) length of the optical flow between two pictures (H, W, 3), pixels (DIS, Kroeger et al. 2016)."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (before, after)]
    if min(grey[0].shape) < 32:
        return np.zeros(grey[0].shape, np.float32)
    flow = search.calc(grey[0], grey[1], np.zeros((*grey[0].shape, 2), np.float32))
    return np.linalg.norm(flow, axis=-1).astype(np.float32)


def _scale(cameras: tuple[Camera, ...], frames: int) -> float:
    longest = max(max(camera.width, camera.height) for camera in cameras)
    pixels = sum(camera.width * camera.height for camera in cameras) * frames
    return min(1.0, MAX_SIDE_PX / longest, (MAX_PIXELS / pixels) ** 0.5)
