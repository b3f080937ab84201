"""Extent of motion: the region of a camera's images that changes over time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.matting.channels import channel_max
from fourd.recording.matting.motion.sampling import CameraSample, Picture

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

MIN_CHANGE = 12.0
"""Lower limit of :attr:`MotionExtent.threshold`, in 8-bit values. The threshold is the larger of two values:
MIN_CHANGE, and NOISE_FACTOR times :attr:`MotionExtent.noise`."""
NOISE_FACTOR = 6.0
MIN_MOTION_PX = 0.15
FLASH_SHARE = 0.5
"""An image of which a larger fraction changes shows another exposure, not motion."""
MOVING_FACTOR = 2.5
"""Minimum optical flow of moving pixels, as a multiple of the flow of static pixels."""


@dataclass(frozen=True, eq=False)
class MotionExtent:
    """Noise levels of a camera's images, and the region that changes.

    Attributes:
        noise: standard deviation of a static pixel's values, in 8-bit values.
        still_px: typical length in pixels of the optical flow that noise causes at static pixels.
        threshold: minimum change of a pixel's value that counts as motion, in 8-bit values.
        region: (h, w) bool mask of the pixels that change in some frame, with holes filled.
    """

    noise: float
    still_px: float
    threshold: float
    region: Flags

    @staticmethod
    def from_sample(sample: CameraSample) -> MotionExtent:
        """Estimate the noise and the extent of motion from sampled frames."""
        median = np.median(sample.rgb, axis=0).astype(np.float32)
        change = np.stack([channel_max(np.abs(picture - median)) for picture in sample.rgb]).astype(np.float32)
        noise = 1.48 * float(np.median(change)) + 1
        threshold = max(MIN_CHANGE, NOISE_FACTOR * noise)
        still = float(np.median(sample.motion_px)) + MIN_MOTION_PX
        # For each pixel, the second largest change over the frames is used, because a flash that lasts one frame
        # affects only the largest change. If the optical flow at the pixel is large in a frame, for example because a
        # foot swings through the pixel, the change in this frame counts even if it is the only large change.
        largest = np.partition(change, -2, axis=0)[-2] if len(change) > 2 else change.max(axis=0)
        largest = np.maximum(largest, np.where(sample.motion_px > MOVING_FACTOR * still, change, 0).max(axis=0))
        region = (largest > threshold).astype(np.uint8)
        region = cv2.morphologyEx(region, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        return MotionExtent(noise, still, threshold, _closed(region))

    def including(self, sample: CameraSample, pictures: Iterable[Picture]) -> MotionExtent:
        """Add what changes in one of the sampled images or of other images (h, w, 3) of the camera. A ball crosses most
        pixels once, or between two sampled frames."""
        median = np.median(sample.rgb, axis=0).astype(np.float32)
        passed = self.region.astype(np.uint8)
        for picture in chain(sample.rgb, pictures):
            changed = channel_max(np.abs(picture - median)) > self.threshold
            if changed.mean() <= FLASH_SHARE:
                blobs = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
                passed |= np.asarray(blobs, np.uint8)
        return replace(self, region=_closed(passed))


def _closed(region: NDArray[np.uint8] | cv2.typing.MatLike) -> Flags:
    """Close the gaps and holes of a region (h, w), and add a margin."""
    closed = cv2.morphologyEx(region, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    return fill_holes(np.asarray(cv2.dilate(closed, np.ones((3, 3), np.uint8)), np.uint8)) > 0


def fill_holes(region: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Fill the enclosed holes of a binary region (h, w)."""
    padded = np.pad(region, 2)
    outside = padded.copy()
    cv2.floodFill(outside, None, (0, 0), 2)
    return (outside[2:-2, 2:-2] != 2).astype(np.uint8)
