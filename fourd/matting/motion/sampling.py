"""A few frames of all cameras, reduced, from which the subject and the background are learned."""

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

MOST_FRAMES = 24
MOST_PIXELS = 32 << 20
"""Of all cameras and frames together: 100 MB of pictures and twice that of what is computed of them."""

LONGEST_SIDE = 512
MOST_STEP = 4
"""Frames between which motion is looked for, at most: 67 ms at 60 frames per second."""


@dataclass(frozen=True, eq=False)
class CameraSample:
    """One camera's sampled frames.

    Attributes:
        camera: of the reduced pictures.
        rgb: (T, h, w, 3) uint8.
        motion_px: (T, h, w) float16, length of the optical flow to a neighbouring frame, in reduced pixels.
    """

    camera: Camera
    rgb: Picture
    motion_px: NDArray[np.float16]


def take_sample(capture: Capture, track: Track) -> list[CameraSample]:
    """Sampled frames of all cameras, evenly spread over the capture, at one scale."""
    frames = sampled_frames(capture.frame_count)
    scale = _scale(capture.cameras, len(frames))
    samples = []
    for index in track(range(len(capture.cameras)), len(capture.cameras), "looking"):
        camera = capture.cameras[index].rescale(scale)
        rgb = np.empty((len(frames), camera.height, camera.width, 3), np.uint8)
        motion = np.zeros((len(frames), camera.height, camera.width), np.float16)
        for place, frame in enumerate(frames):
            rgb[place] = reduced(capture.image(index, frame), camera)
            beside = neighbour(frame, capture.frame_count)
            if beside is not None:
                motion[place] = motion_px(rgb[place], reduced(capture.image(index, beside), camera))
        samples.append(CameraSample(camera, rgb, motion))
    return samples


def neighbour(frame: int, count: int) -> int | None:
    """The frame against which motion at ``frame`` of ``count`` is measured; None where there is no other."""
    step = min(MOST_STEP, max(1, count // MOST_FRAMES))
    beside = frame + step if frame + step < count else frame - step
    return beside if beside >= 0 else None


def sampled_frames(count: int) -> list[int]:
    """Which of ``count`` frames the subject is learned from."""
    return sample_indices(count, MOST_FRAMES)


def reduced(picture: Picture, camera: Camera) -> Picture:
    """The picture (H, W[, C]) at ``camera``'s size, averaged over what a pixel covers."""
    if picture.shape[:2] == (camera.height, camera.width):
        return picture
    return np.asarray(cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA), np.uint8)


def motion_px(before: Picture, after: Picture) -> Floats:
    """(H, W) length of the optical flow between two pictures (H, W, 3), in pixels (DIS, Kroeger et al. 2016)."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (before, after)]
    if min(grey[0].shape) < 32:
        return np.zeros(grey[0].shape, np.float32)
    flow = search.calc(grey[0], grey[1], np.zeros((*grey[0].shape, 2), np.float32))
    return np.linalg.norm(flow, axis=-1).astype(np.float32)


def _scale(cameras: tuple[Camera, ...], frames: int) -> float:
    longest = max(max(camera.width, camera.height) for camera in cameras)
    pixels = sum(camera.width * camera.height for camera in cameras) * frames
    return min(1.0, LONGEST_SIDE / longest, (MOST_PIXELS / pixels) ** 0.5)
