"""A picklable description of the selected part of a capture, for worker processes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.capture import Capture, open_capture

CACHE_MB = 64
CACHE_FRAMES = 8
"""Decoded frames of all cameras to cache: a frame and those up to its neighbour for optical flow."""


@dataclass(frozen=True)
class Selection:
    """A capture with selected views and frames; see :func:`fourd.capture.open_capture`."""

    path: Path
    views: tuple[str, ...] | None = None
    frames: str | None = None

    def open(self, *, mattes: bool = True) -> Capture:
        """Open the capture, with a cache for the frames between which optical flow is computed."""
        return open_capture(
            self.path,
            views=self.views,
            frames=self.frames,
            cache_mb=CACHE_MB,
            cache_frames=CACHE_FRAMES,
            mattes=mattes,
        )
