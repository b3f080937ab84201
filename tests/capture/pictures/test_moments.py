"""Matching of image files of several cameras by the frame numbers in their names."""

from __future__ import annotations

import random

import pytest

from fourd.base.formats.frame_numbers import sort_sequence, varying_numbers
from fourd.recording.capture.pictures.moments import match_frames, match_masks

PATTERNS = (
    ("plain", "{n}", "{n:06d}"),
    ("text", "frame_{n}", "frame_{n:04d}"),
    ("other words", "frame_{n:04d}", "img_{n}"),
    ("camera in front", "cam1_{n:06d}", "cam2_{n:06d}"),
    ("camera behind", "{n:05d}_cam1", "{n:05d}_cam2"),
    ("clip names", "A001_C002_{n:04d}", "B001_C007_{n:04d}"),
)


@pytest.mark.parametrize(("first", "second"), [pattern[1:] for pattern in PATTERNS], ids=[each[0] for each in PATTERNS])
def test_images_with_the_same_number_are_one_frame(first: str, second: str) -> None:
    """Catches pairing by position, and by the alphabetical order 1, 10, 2."""
    generator = random.Random(0)
    wanted = sorted(generator.sample(range(1, 130), 40))
    lost_first, lost_second = wanted[3], wanted[20]
    names = {
        "a": [first.format(n=n) for n in wanted if n != lost_first],
        "b": [second.format(n=n) for n in wanted if n != lost_second],
    }
    for each in names.values():
        generator.shuffle(each)
    matched = match_frames(names, renumber=True)
    for number in wanted:
        frame = f"{number:06d}"
        assert matched["a"].get(frame) == (None if number == lost_first else first.format(n=number))
        assert matched["b"].get(frame) == (None if number == lost_second else second.format(n=number))
    assert list(matched["a"]) == sorted(matched["a"])


def test_equal_names_are_kept_as_frame_names() -> None:
    """Catches a capture whose frames get other names because one image of a camera is lost."""
    stems = {"a": ["frame_1", "frame_2", "frame_10"], "b": ["frame_1", "frame_10"]}
    assert match_frames(stems)["a"] == {"frame_1": "frame_1", "frame_2": "frame_2", "frame_10": "frame_10"}
    assert list(match_frames(stems)["a"]) == ["frame_1", "frame_2", "frame_10"]


def test_time_stamps_that_differ_match_nothing() -> None:
    """Catches time stamps that are cut to whole seconds, or paired by their order."""
    stems = {"a": ["10.033", "10.066", "10.100"], "b": ["10.034", "10.067", "10.101"]}
    matched = match_frames(stems, renumber=True)
    assert not set(matched["a"]) & set(matched["b"])


def test_a_frame_number_beside_a_time_stamp_is_used() -> None:
    """Catches names with two varying numbers that match nothing."""
    stems = {"a": ["0001_170033", "0002_170066", "0004_170133"], "b": ["0001_170034", "0002_170067", "0003_170101"]}
    matched = match_frames(stems, renumber=True)
    assert list(matched["a"]) == ["000001", "000002", "000004"]
    assert list(matched["b"]) == ["000001", "000002", "000003"]


def test_decimal_times_are_sorted_by_value() -> None:
    """Catches natural order, in which 0.15 comes after 0.2."""
    stems = {"a": ["0.2", "0.15", "10.0"]}
    assert list(match_frames(stems)["a"]) == ["0.15", "0.2", "10.0"]


@pytest.mark.parametrize(
    ("masks", "frames", "expected"),
    [
        (["m_1", "m_2"], ["000001", "000002"], {"000001": "m_1", "000002": "m_2"}),
        (["left_mask", "right_mask"], ["left", "right"], {"left": "left_mask", "right": "right_mask"}),
        (["5"], ["0", "5"], {"5": "5"}),
        (["x"], ["0", "5"], {"x": "x"}),
    ],
)
def test_masks_belong_to_frames(masks: list[str], frames: list[str], expected: dict[str, str]) -> None:
    """Catches masks that are found only if they have the very names of the images."""
    assert match_masks(masks, frames) == expected


def test_repeated_numbers_are_no_frame_numbers() -> None:
    assert varying_numbers(["1", "01"]) is None
    assert varying_numbers(["a", "b"]) is None
    assert varying_numbers(["scan2_3", "scan2_4"]) == [3, 4]


def test_sequences_are_in_the_order_of_their_frames() -> None:
    """Catches the order 1, 10, 2, and the last number as frame number although it is that of a version."""
    names = ["cloud_10_v2", "cloud_2_v2", "cloud_1_v2"]
    assert sort_sequence(names) == ([2, 1, 0], (1, 2, 10))
    assert sort_sequence(["b_1", "a_2"]) == ([0, 1], (1, 2))
    assert sort_sequence(["b", "a"]) == ([1, 0], (0, 1))
    assert sort_sequence(["1_2", "10_2", "1_10"]) == ([0, 2, 1], (0, 1, 2))
