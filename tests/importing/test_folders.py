"""Tests of the matching of cameras with frames to calibrated cameras."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.recording.importing.folders import match_names


@pytest.mark.parametrize(
    ("calibrated", "found", "pairs"),
    [
        (("1", "2"), ("cam-1_2023", "cam-2_2023"), {"cam-1_2023": "1", "cam-2_2023": "2"}),
        (("01", "02"), ("1", "2"), {"1": "01", "2": "02"}),
        # The last numbers are those of other cameras.
        (("cam1", "cam2", "cam3"), ("1_take3", "2_take3"), {"1_take3": "cam1", "2_take3": "cam2"}),
        (("cam_1_v2", "cam_2_v2"), ("a1", "a2"), {"a1": "cam_1_v2", "a2": "cam_2_v2"}),
        (("35441", "35442"), ("Miqus_1_35441", "Miqus_2_35442"), {"Miqus_1_35441": "35441", "Miqus_2_35442": "35442"}),
        (("A", "B"), ("2019-08-02-vid01-camA", "2019-08-02-vid01-camB"), None),
        (("caf\u00e9", "b"), ("cafe\u0301", "b"), {"cafe\u0301": "caf\u00e9", "b": "b"}),
    ],
)
def test_names_are_matched(calibrated: tuple[str, ...], found: tuple[str, ...], pairs: dict[str, str] | None) -> None:
    """Catches a calibration that is given to another camera, because a number of the take or of the year is taken for
    the number of the camera."""
    expected = dict(zip(found, calibrated, strict=True)) if pairs is None else pairs
    assert match_names(calibrated, found, Path("calibration.toml")) == expected


def test_names_that_do_not_match() -> None:
    """Catches a match of cameras that have nothing in common."""
    with pytest.raises(UserError, match=r"calibration.toml: expected calibrations with the names of the cameras \(a,"):
        match_names(("1", "2"), ("a", "b"), Path("calibration.toml"))
