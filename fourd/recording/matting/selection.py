"""A picklable selection of a capture's views and frames, for worker processes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.recording.capture import Capture, open_capture

CACHE_MB = 64
CACHE_FRAMES = 8
"""Number of frames that the cache of decoded images can hold in addition to CACHE_MB MiB of images. A frame has one
image per camera.

The two frames between which optical flow is computed are a few frames apart. The cache must have room for both and for
all frames between them.
"""


@dataclass(frozen=True)
class Selection:
    """Arguments of :func:`fourd.recording.capture.open_capture` that select views and frames of a capture."""

    path: Path
    views: tuple[str, ...] | None = None
    frames: str | None = None

    def open(self, *, mattes: bool = True) -> Capture:
        """Open the capture with a frame cache that is large enough for computing optical flow."""
        return open_capture(
            self.path,
            views=self.views,
            frames=self.frames,
            cache_mb=CACHE_MB,
            cache_frames=CACHE_FRAMES,
            mattes=mattes,
        )
