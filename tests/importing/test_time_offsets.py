"""Which estimated time offsets are applied, and how those that are not applied are reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fourd.pipeline.report.decisions import describe_offsets as describe_decided
from fourd.recording.capture.video_list import NAME as VIDEO_LIST
from fourd.recording.importing.record import ImportRecord, describe_unsure, read_record, write_record
from fourd.recording.importing.time_offsets import Estimate, applied_offsets, describe_offsets
from tests.importing.test_importer import run_import
from tests.sync.discs import write_disc_videos

FRAMES = {"a": 0.0, "b": 27.1, "c": 47.97, "d": -2.0}
CONFIDENCE = {"a": 0.8, "b": 0.9, "c": 0.45, "d": 0.8}


def record(unsure: dict[str, float]) -> ImportRecord:
    options = {"sync_if_possible": True}
    return ImportRecord("videos", "videos", "", "", options, {"b": 27.1}, False, True, (), unsure)


def test_small_offsets_are_applied_beside_large_ones() -> None:
    """Catches a camera that stays two frames late although the cameras have no common trigger, and an offset of two
    frames that is applied although it may be the error of synchronous cameras."""
    assert applied_offsets(Estimate("epipolar", FRAMES, CONFIDENCE, 30), {}, True) == {"a": 0.0, "b": 27.1, "d": -2.0}
    assert applied_offsets(Estimate("epipolar", {"a": 0.0, "d": -2.0}, {"a": 0.8, "d": 0.8}, 30), {}, True) == {}
    assert applied_offsets(Estimate("motion", FRAMES, CONFIDENCE, 30), {}, True) == {"b": 27.1}


def test_the_users_offsets_replace_estimates() -> None:
    """Catches an estimate that overrides --offset, and a log that says that it is applied."""
    estimate = Estimate("epipolar", FRAMES, CONFIDENCE, 30)
    assert applied_offsets(estimate, {"b": 26.0}, True) == {"a": 0.0, "b": 26.0, "d": -2.0}
    lines = list(describe_offsets(estimate, {"b": 26.0}, True))
    assert lines[1] == "b: +27 frames (+27.10), confidence 90%, not applied, because --offset sets +26"


def test_an_unsure_offset_is_reported_with_its_option() -> None:
    """Catches a user who is not told how to apply an offset that was found."""
    estimate = Estimate("epipolar", FRAMES, CONFIDENCE, 30)
    assert estimate.candidates({}) == {"c": 47.97}
    lines = list(describe_offsets(estimate, {}, True))
    assert lines[2] == "c: +48 frames (+47.97), confidence 45%, not applied; --offset c=47.97 applies it"
    assert Estimate("epipolar", {"a": 0.0, "c": 30.0}, {"a": 0.8, "c": 0.05}, 30).candidates({}) == {}


def test_unsure_offsets_are_named_for_corrected_captures_too(tmp_path: Path) -> None:
    """Catches an error about mattes that does not name the likely cause, because the calibration was corrected in
    another folder. Also catches a crash for folders that no import wrote."""
    imported, corrected = tmp_path / "capture", tmp_path / "repaired"
    write_record(imported, record({"c": 47.97}))
    (imported / VIDEO_LIST).write_text("{}")
    corrected.mkdir()
    (corrected / VIDEO_LIST).symlink_to(imported / VIDEO_LIST)
    expected = (
        "time offsets were found but not applied, because they are not sure (c +47.97 frames); to apply them, add "
        "--offset c=47.97 to fourd make or fourd import"
    )
    assert describe_unsure(imported) == describe_unsure(corrected) == expected
    write_record(imported, record({}))
    assert describe_unsure(imported) == describe_unsure(tmp_path / "none") == ""


def test_the_summary_names_unsure_offsets() -> None:
    """Catches a summary of fourd make that hides an offset that was found."""
    applied, unsure = describe_decided(record({"c": 47.97}))
    assert applied == (
        "time offsets between the videos: b +27.1 frames; --sync none estimates none; --offset CAMERA=FRAMES sets them"
    )
    assert unsure == "time offsets that are not sure: c +47.97 frames are not applied; --offset c=47.97 applies them"


def test_given_and_estimated_offsets_are_applied_together(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches an option --offset that switches the estimates of the other cameras off."""
    source = write_disc_videos(tmp_path / "source", ("a", "b", "c"), (0, -9, 0), 84, rng)
    lines = run_import(source, tmp_path / "out", sync_if_possible=True, offsets={"c": 4.0})
    assert any(line.startswith("c: ") and line.endswith("not applied, because --offset sets +4") for line in lines)
    assert any(line.startswith("b: -9 frames") and line.endswith(", applied") for line in lines)
    made = read_record(tmp_path / "out")
    assert made is not None
    assert made.offsets["c"] == 4
    assert abs(made.offsets["b"] + 9) < 0.5
