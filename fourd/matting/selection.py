"""Which part of a capture is worked on, in words that a process can be given."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.capture import Capture, open_capture

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
        capture = open_capture(self.path, views=self.views, frames=self.frames, mattes=mattes)
        frame_bytes = sum(3 * camera.width * camera.height for camera in capture.cameras)
        cache_mb = 64 + (CACHE_FRAMES * frame_bytes >> 20)
        return open_capture(self.path, views=self.views, frames=self.frames, cache_mb=cache_mb, mattes=mattes)
