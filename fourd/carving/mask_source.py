"""What carving needs of a capture, so that tests and importers can stand in for one."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera


class MaskSource(Protocol):
    """The part of :class:`fourd.capture.Capture` that carving reads."""

    @property
    def path(self) -> Path:
        """The capture's folder, for messages."""

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names, in the order of ``cameras``."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Undistorted pinholes."""

    @property
    def frame_count(self) -> int:
        """Number of frames."""

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        """The frames' numbers in the capture."""

    def mask(self, camera: int, frame: int) -> NDArray[np.uint8]:
        """(H, W) uint8 matte, 255 = object."""

    def image(self, camera: int, frame: int) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 RGB."""


def frame_masks(capture: MaskSource, frame: int) -> list[NDArray[np.uint8]]:
    """All cameras' masks of one frame."""
    return [capture.mask(camera, frame) for camera in range(len(capture.cameras))]
