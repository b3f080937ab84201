"""Which part of a capture is worked on, in words that a process can be given."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.capture import Capture, open_capture

CACHE_MB = 64
CACHE_FRAMES = 8
"""Frames of all cameras to keep decoded: a frame and those up to the one that motion is told from."""


@dataclass(frozen=True)
class Selection:
    """Which part of which capture; see :func:`fourd.capture.open_capture`."""

    path: Path
    views: tuple[str, ...] | None = None
    frames: str | None = None

    def open(self, *, mattes: bool = True) -> Capture:
        """The capture, with room for the frames between which motion is looked for."""
        return open_capture(
            self.path,
            views=self.views,
            frames=self.frames,
            cache_mb=CACHE_MB,
            cache_frames=CACHE_FRAMES,
            mattes=mattes,
        )
