"""Divide the frames of a run into overlapping segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fourd.reconstruction.training.config import SegmentConfig


@dataclass(frozen=True)
class SegmentPlan:
    """The frames of each segment.

    Attributes:
        ranges: for each segment, the range of its frames, as indices into the selected frames. No frame belongs to
            three segments.
        overlap: number of frames that two successive segments have in common.
    """

    ranges: tuple[range, ...]
    overlap: int

    @classmethod
    def divide(cls, frame_count: int, config: SegmentConfig) -> SegmentPlan:
        """Divide ``frame_count`` frames into the smallest possible number of segments, whose lengths differ by at most
        one frame.

        ``config.frames`` must not be None.
        """
        assert config.frames is not None, "expected a run with segments"
        shared = config.overlap
        count = max(1, -(-(frame_count - shared) // (config.frames - shared)))
        starts = [segment * (frame_count - shared) // count for segment in range(count)]
        stops = [start + shared for start in starts[1:]] + [frame_count]
        return cls(tuple(range(start, stop) for start, stop in zip(starts, stops, strict=True)), shared)

    def shares(self, frame: int) -> tuple[tuple[int, float], ...]:
        """Return (segment, share) for each segment that contains ``frame``, where the share is the fraction of its
        points that the segment contributes to the frame. The shares sum to 1.

        Where two segments overlap, the share of the later segment grows linearly from frame to frame.
        """
        owners = [segment for segment, frames in enumerate(self.ranges) if frame in frames]
        if len(owners) == 1:
            return ((owners[0], 1.0),)
        first, second = owners
        share = (frame - self.ranges[second].start + 1) / (self.overlap + 1)
        return ((first, 1.0 - share), (second, share))


def frame_range(numbers: Sequence[int], frames: range) -> str:
    """Return the config value ``frames`` (A:B or A:B:S) that selects the frames of a segment.

    Args:
        numbers: for each frame of the run, its index in the capture. The indices are evenly spaced.
        frames: indices of the segment's frames in ``numbers``.
    """
    step = numbers[1] - numbers[0] if len(numbers) > 1 else 1
    text = f"{numbers[frames[0]]}:{numbers[frames[-1]] + 1}"
    return text if step == 1 else f"{text}:{step}"
