"""Where in a camera's pictures anything ever moves."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.matting.motion.channels import channel_max
from fourd.matting.motion.sampling import CameraSample

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

LEAST_CHANGE = 12.0
"""Of 255: a pixel that never changes by more shows one thing alone."""
NOISES = 6.0
LEAST_MOTION_PX = 0.15
MOVING = 2.5
"""Times the flow of what is still."""


@dataclass(frozen=True, eq=False)
class Swept:
    """How still a camera's pictures are, and where they are not.

    Attributes:
        noise: standard deviation of a still pixel's values, of 255.
        still_px: optical flow that is none, in pixels.
        change: of a pixel's values that is more than noise.
        region: (h, w) bool, where things change at some time, holes filled.
    """

    noise: float
    still_px: float
    change: float
    region: Flags

    @staticmethod
    def of(sample: CameraSample) -> Swept:
        """As the sampled frames show it."""
        median = np.median(sample.rgb, axis=0).astype(np.float32)
        away = np.stack([channel_max(np.abs(picture - median)) for picture in sample.rgb]).astype(np.float32)
        noise = 1.48 * float(np.median(away)) + 1
        change = max(LEAST_CHANGE, NOISES * noise)
        still = float(np.median(sample.motion_px)) + LEAST_MOTION_PX
        # The second largest, since a flash of one frame is no subject; unless it moves: a swinging foot is seen once.
        farthest = np.partition(away, -2, axis=0)[-2] if len(away) > 2 else away.max(axis=0)
        farthest = np.maximum(farthest, np.where(sample.motion_px > MOVING * still, away, 0).max(axis=0))
        region = (farthest > change).astype(np.uint8)
        region = cv2.morphologyEx(region, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        region = cv2.morphologyEx(region, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
        region = filled(np.asarray(cv2.dilate(region, np.ones((3, 3), np.uint8)), np.uint8))
        return Swept(noise, still, change, region > 0)


def filled(region: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The region (h, w) of ones with the holes that it encloses."""
    padded = np.pad(region, 2)
    outside = padded.copy()
    cv2.floodFill(outside, None, (0, 0), 2)
    return (outside[2:-2, 2:-2] != 2).astype(np.uint8)
