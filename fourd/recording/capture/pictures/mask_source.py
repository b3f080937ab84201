"""The interface through which carving reads a capture. Tests and importers can implement it."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera


class MaskSource(Protocol):
    """The part of :class:`fourd.recording.capture.Capture` that carving reads."""

    @property
    def path(self) -> Path:
        """Folder of the capture, for error messages."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras, in the order of ``cameras``."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Undistorted pinhole cameras."""

    @property
    def frame_count(self) -> int:
        """Number of frames."""

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        """Indices of the selected frames in the whole capture. The first index may be greater than 0."""

    def mask(self, camera: int, frame: int) -> NDArray[np.uint8]:
        """Return the matte (H, W) uint8; 255 is the object."""

    def image(self, camera: int, frame: int) -> NDArray[np.uint8]:
        """Return the RGB image (H, W, 3) uint8."""


def frame_masks(capture: MaskSource, frame: int) -> list[NDArray[np.uint8]]:
    """Return the masks of all cameras in one frame."""
    return [capture.mask(camera, frame) for camera in range(len(capture.cameras))]
