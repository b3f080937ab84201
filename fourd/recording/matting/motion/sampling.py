"""Sampling of a few frames of all cameras, at reduced size, for learning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.progress import Track
from fourd.recording.capture import Capture
from fourd.recording.capture.layout import sample_indices

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

MAX_FRAMES = 24
MIN_FRAMES = 8
MAX_IMAGES = 648
"""Maximum number of sampled images of all cameras together, if this allows MIN_FRAMES frames. The time for learning is
proportional to it."""
MAX_PASSED_IMAGES = 4096
"""Maximum number of images of all cameras together in which something is looked for that only passes."""
MAX_PIXELS = 32 << 20
"""Maximum total number of sampled pixels in all cameras and frames. With this limit, the sampled images need 100 MB,
and the data computed from them needs 200 MB."""

MAX_SIDE_PX = 512
MAX_STEP = 4
"""The two frames between which optical flow is computed are at most this number of frames apart. At 60 frames per
second, 4 frames take 67 ms."""


@dataclass(frozen=True, eq=False)
class CameraSample:
    """One camera's sampled frames.

    Attributes:
        camera: camera of the reduced images.
        rgb: (T, h, w, 3) uint8 reduced images.
        motion_px: (T, h, w) float16 length of the optical flow to a neighbouring frame, in pixels of the reduced
            images.
    """

    camera: Camera
    rgb: Picture
    motion_px: NDArray[np.float16]


def sample_capture(capture: Capture, frames: Sequence[int], track: Track) -> list[CameraSample]:
    """Sample the ``frames`` of all cameras, and reduce all images by the same factor."""
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


def passed_frames(count: int, cameras: int, learning: Sequence[int]) -> list[int]:
    """Return the indices of the frames, besides the ``learning`` frames, in which something is looked for that only
    passes: all frames of a short capture."""
    return sorted({*sample_indices(count, max(1, MAX_PASSED_IMAGES // cameras))} - {*learning})


def flow_frame(frame: int, count: int) -> int | None:
    """Return the index of the frame to which the optical flow of ``frame`` is computed, or None if ``count`` is 1.

    ``count`` is the capture's number of frames.
    """
    step = min(MAX_STEP, max(1, count // MAX_FRAMES))
    other = frame + step if frame + step < count else frame - step
    return other if other >= 0 else None


def learning_frames(count: int, cameras: int = 1) -> list[int]:
    """Return the indices of the frames from which the subject is learned, for a capture of ``count`` frames.

    With many ``cameras``, fewer frames are used, because the other cameras then show what a camera's frames do not.
    """
    return sample_indices(count, max(MIN_FRAMES, min(MAX_FRAMES, MAX_IMAGES // cameras)))


def reduce_picture(picture: Picture, camera: Camera) -> Picture:
    """Reduce an image (H, W[, C]) to ``camera``'s size by area averaging."""
    if picture.shape[:2] == (camera.height, camera.width):
        return picture
    return np.asarray(cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA), np.uint8)


def flow_length_px(before: Picture, after: Picture) -> Floats:
    """Return the length (H, W) in pixels of the optical flow between two images (H, W, 3) (DIS, Kroeger et al.
    2016)."""
    return np.linalg.norm(flow_field(before, after), axis=-1).astype(np.float32)


def flow_field(before: Picture, after: Picture) -> Floats:
    """Return the optical flow (H, W, 2) in pixels, x then y, between two images (H, W, 3) (DIS, Kroeger et al. 2016).

    The flow is 0 for images with a side below 32 pixels.
    """
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (before, after)]
    still = np.zeros((*grey[0].shape, 2), np.float32)
    return still if min(grey[0].shape) < 32 else np.asarray(search.calc(grey[0], grey[1], still), np.float32)


def _scale(cameras: tuple[Camera, ...], frames: int) -> float:
    longest = max(max(camera.width, camera.height) for camera in cameras)
    pixels = sum(camera.width * camera.height for camera in cameras) * frames
    return min(1.0, MAX_SIDE_PX / longest, (MAX_PIXELS / pixels) ** 0.5)
