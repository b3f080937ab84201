"""The check decodes all files if there is time, and otherwise an even sample, and says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.base.progress import untracked
from fourd.recording.capture.checks import damage
from fourd.recording.capture.checks.damage import PROBES, decode_pictures

FILES = [Path(f"{camera:02d}/{frame:06d}.jpg") for camera in range(10) for frame in range(100)]


class Clock:
    """A clock that advances by ``step`` seconds when a file is decoded."""

    def __init__(self, step: float) -> None:
        self.now, self.step = 0.0, step
        self.decoded: list[Path] = []

    def decode(self, file: Path) -> None:
        self.now += self.step
        self.decoded.append(file)


def run(monkeypatch: pytest.MonkeyPatch, step: float, max_seconds: float) -> tuple[Clock, damage.Skipped | None]:
    clock = Clock(step)
    monkeypatch.setattr(damage, "monotonic", lambda: clock.now)
    return clock, decode_pictures(FILES, clock.decode, max_seconds, untracked)


def test_all_files_are_decoded_if_there_is_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a check that misses a damaged file although decoding all takes only some seconds."""
    clock, skipped = run(monkeypatch, 0.01, 60)
    assert skipped is None
    assert sorted(clock.decoded) == FILES


def test_a_sample_of_all_cameras_is_decoded_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a check that takes an hour, a sample of only the first cameras, and a sample that is not reported."""
    clock, skipped = run(monkeypatch, 0.1, 60)
    assert skipped is not None
    assert len(clock.decoded) == 150 == skipped.total - skipped.count
    assert {file.parent.name for file in clock.decoded} == {f"{camera:02d}" for camera in range(10)}
    assert str(skipped) == (
        "150 of 1000 files were decoded to find damaged ones; decoding all takes about 100 s: add --deep"
    )


def test_slow_files_and_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a negative number of files, and decoding although none was asked for."""
    clock, skipped = run(monkeypatch, 10, 60)
    assert len(clock.decoded) == PROBES
    assert skipped is not None
    assert "about 167 minutes" in str(skipped)
    clock, skipped = run(monkeypatch, 10, 0)
    assert (clock.decoded, skipped) == ([], None)
