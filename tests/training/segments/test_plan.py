"""Tests of the division of frames into segments, of the cross-fade and of the start from a previous segment."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.reconstruction.training.config import SegmentConfig, TrainConfig
from fourd.reconstruction.training.segments.fade import kept_points
from fourd.reconstruction.training.segments.plan import SegmentPlan, frame_range
from fourd.recording.capture.layout import parse_frame_range


def test_every_frame_belongs_to_one_segment_or_to_two_neighbours(rng: np.random.Generator) -> None:
    """Catches lost frames, segments that are too long, segments of uneven length, and frames of three segments."""
    for _ in range(200):
        overlap = int(rng.integers(0, 8))
        config = SegmentConfig(frames=int(rng.integers(max(2, 3 * overlap), 60)), overlap=overlap)
        assert config.frames is not None
        count = int(rng.integers(1, 400))
        plan = SegmentPlan.divide(count, config)
        lengths = [len(frames) for frames in plan.ranges]
        assert max(lengths) <= config.frames, (count, config)
        assert min(lengths) >= max(lengths) - 1, (count, config)
        assert [plan.ranges[0].start, plan.ranges[-1].stop] == [0, count]
        for before, after in zip(plan.ranges[:-1], plan.ranges[1:], strict=True):
            assert before.stop - after.start == overlap, (count, config)
        for frame in range(count):
            shares = plan.shares(frame)
            assert sum(share for _, share in shares) == pytest.approx(1.0)
            assert all(0 < share <= 1 for _, share in shares)
            assert [segment for segment, _ in shares] == sorted(
                segment for segment, frames in enumerate(plan.ranges) if frame in frames
            )


def test_the_share_of_the_next_segment_grows_evenly() -> None:
    """Catches a fade that jumps at its first or last frame, and a fade in the wrong direction."""
    plan = SegmentPlan.divide(20, SegmentConfig(frames=12, overlap=4))
    assert plan.ranges == (range(12), range(8, 20))
    second = [dict(plan.shares(frame)).get(1, 0.0) for frame in range(7, 13)]
    assert second == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])


@pytest.mark.parametrize("selection", [None, "3:40", "5:90:7", "99:100"])
def test_the_range_of_a_segment_selects_its_frames(selection: str | None) -> None:
    """Catches a segment that trains on frames of other segments if the run uses only every S-th frame."""
    numbers = parse_frame_range(selection, 100)
    for frames in SegmentPlan.divide(len(numbers), SegmentConfig(frames=9, overlap=2)).ranges:
        assert list(parse_frame_range(frame_range(numbers, frames), 100)) == [numbers[frame] for frame in frames]


def test_a_fade_keeps_the_number_of_points_and_spreads_them() -> None:
    """Catches a cross-fade that changes the number of points or leaves gaps in the sequence of points. Also catches a
    cross-fade that keeps the point with the same index from both segments.
    """
    for share in (0.2, 0.5, 0.8):
        first = kept_points(10_000, 1 - share, is_first=True)
        second = kept_points(10_000, share, is_first=False)
        assert sorted([*first, *second]) == list(range(10_000))
        assert len(second) == pytest.approx(10_000 * share, abs=5)
        assert np.diff(second).max() <= np.ceil(2 / share)
    assert len(kept_points(100, 1.0, is_first=True)) == len(kept_points(100, 1.0, is_first=False)) == 100


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"frames": 11, "overlap": 4}, "frames: expected at least 12 with an overlap of 4 frames, got 11"),
        ({"frames": 1, "overlap": 0}, "frames: expected at least 2 with an overlap of 0 frames, got 1"),
        ({"overlap": -1}, "overlap: expected 0 or more, got -1"),
    ],
)
def test_impossible_segments_are_refused(values: dict[str, int], message: str) -> None:
    """Catches segments that are shorter than their overlaps."""
    with pytest.raises(ValueError, match=message):
        SegmentConfig(**values)  # type: ignore[arg-type]


def test_whole_scenes_have_no_segments() -> None:
    """Catches full scenes that are trained in segments. Their background would change between segments."""
    with pytest.raises(ValueError, match=r"segments.frames: expected scene: object"):
        TrainConfig(scene="full", segments=SegmentConfig(frames=24))
