"""The size of a capture, from which stages estimate how long they will take."""

from __future__ import annotations

from dataclasses import dataclass

MATCH_S_PER_MP = 1.2
"""Seconds to decode and match one megapixel of images. Measured: 32 s for 3 frames of 8.3 megapixels."""
SAMPLED_FRAMES = 3
"""Number of frames of each camera in which an import and a repair match features; see
:mod:`fourd.recording.importing.importer`."""


@dataclass(frozen=True)
class Workload:
    """The size of a capture.

    Attributes:
        cameras: number of cameras.
        frames: number of selected frames of each camera, or None if the video headers do not contain it.
        megapixels: size of one image in megapixels.
        workers: number of processes.
    """

    cameras: int
    frames: int | None
    megapixels: float
    workers: int

    @property
    def known_frames(self) -> int:
        """The number of frames, or 1 if it is not known."""
        return self.frames or 1

    def matching_s(self, frames: int = SAMPLED_FRAMES) -> float:
        """Return the seconds for matching features in up to ``frames`` frames of each camera."""
        return MATCH_S_PER_MP * self.cameras * min(frames, self.known_frames) * self.megapixels
