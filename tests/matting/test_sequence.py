"""Mattes of a whole capture: accuracy without a network, resuming after an interruption, and reproducibility."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.progress import untracked
from fourd.recording.calibration.checks.agreement import match_capture
from fourd.recording.capture import Capture, open_capture
from fourd.recording.capture.check import check_capture
from fourd.recording.matting.contours import find_foreign_mattes
from fourd.recording.matting.output import MODEL_NAME, SHEET
from fourd.recording.matting.selection import CACHE_FRAMES, Selection
from fourd.recording.matting.sequence import MATTES, MatteSettings, make_mattes
from tests.matting.captures import matte_iou, write_capture_without_masks


def contents(capture: Path) -> dict[str, bytes]:
    return {str(path.relative_to(capture)): path.read_bytes() for path in sorted(capture.glob(".fourd/mattes/*/*"))}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball capture with mattes that fourd has made. Tests must not change this capture."""
    capture = write_capture_without_masks(tmp_path_factory.mktemp("made"), frames=6, size=96)
    assert make_mattes(Selection(capture), MatteSettings(), 1, untracked) == 6
    return capture


def test_mattes_match_the_subject(made: Path) -> None:
    """Catches foreground evidence with the wrong sign, permuted views, and mattes that are not aligned with the
    images."""
    found = matte_iou(open_capture(made), made.parent / "truth")
    assert found.mean() > 0.85, found.round(2)
    assert found.mean(axis=1).min() > 0.75, found.round(2)


def test_mattes_do_not_flicker(made: Path) -> None:
    """Catches flicker, which means pixels that differ from both the previous and the next frame."""

    def flips(folder: Path) -> float:
        shares = []
        for camera in sorted(path for path in folder.iterdir() if path.is_dir()):
            frames = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 127 for path in sorted(camera.glob("*.png"))]
            for before, now, after in zip(frames, frames[1:], frames[2:], strict=False):
                shares.append(((now != before) & (now != after)).sum() / max(1, now.sum()))
        return float(np.mean(shares))

    assert flips(made / MATTES) < flips(made.parent / "truth" / "masks") + 0.03


def test_only_missing_files_are_made_again(made: Path, tmp_path: Path) -> None:
    """Catches finished mattes that are made again or overwritten, and results that depend on where the work resumes."""
    before = contents(made)
    lost = made / MATTES / "03" / "000004.png"
    lost.unlink()
    with pytest.raises(
        UserError, match=r"mattes/03: expected mattes of 6 frames, got 5; make the missing mattes with: fourd matte"
    ):
        open_capture(made)
    half = made / MATTES / "03" / ".unfinished-000005-killed.png"
    half.write_bytes(b"half")
    times = {path: path.stat().st_mtime_ns for path in made.glob(".fourd/mattes/*/[!.]*")}
    assert make_mattes(Selection(made), MatteSettings(), 1, untracked) == 1
    assert not half.exists()
    assert contents(made) == before
    assert all(path.stat().st_mtime_ns == time for path, time in times.items())
    assert make_mattes(Selection(made), MatteSettings(), 1, untracked) == 0


@pytest.mark.slow
def test_mattes_of_some_frames_are_no_problem(made: Path, tmp_path: Path) -> None:
    """Catches a capture that cannot be used any more after `fourd matte --frames`, because its other frames have no
    mattes."""
    capture = shutil.copytree(made, tmp_path / "capture")
    (capture / MATTES / "03" / "000004.png").unlink()
    report = check_capture(capture)
    assert report.problems == ()
    assert not report.has_masks
    assert find_foreign_mattes(capture) == []
    assert len(match_capture(capture).cameras) == 8


def test_two_processes_make_the_same_bytes(made: Path, tmp_path: Path) -> None:
    """Catches mattes that depend on how the frames are distributed over processes."""
    before = contents(made)
    for path in made.glob(".fourd/mattes/*/*"):
        path.unlink()
    assert make_mattes(Selection(made), MatteSettings(), 2, untracked) == 6
    assert contents(made) == before


def test_a_capture_is_opened_once(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches processes that list folders of thousands of files a second time to determine the cache size."""
    opened = []

    def counted(path: Path, **options: Any) -> Capture:
        opened.append(path)
        return open_capture(path, **options)

    monkeypatch.setattr("fourd.recording.matting.selection.open_capture", counted)
    capture = Selection(made).open()
    assert len(opened) == 1
    first = [capture.image(camera, 0) for camera in range(8)]
    for frame in range(1, CACHE_FRAMES - 2):
        capture.image(0, frame)
    assert all(capture.image(camera, 0) is picture for camera, picture in enumerate(first))


def test_changed_settings_invalidate_mattes(tmp_path: Path) -> None:
    """Catches outdated mattes after a change of the seed or the input, and an outdated contact sheet."""
    capture = write_capture_without_masks(tmp_path, frames=3, size=64)
    assert make_mattes(Selection(capture), MatteSettings(), 1, untracked) == 3
    assert (capture / ".fourd" / MODEL_NAME).exists()
    (capture / SHEET).write_bytes(b"of these")
    assert make_mattes(Selection(capture), MatteSettings(seed=1), 1, untracked) == 3
    assert not (capture / SHEET).exists()
    picture = capture / "images" / "00" / "000001.png"
    picture.write_bytes(picture.read_bytes() + b"\0")
    assert make_mattes(Selection(capture), MatteSettings(seed=1), 1, untracked) == 3


def test_models_are_learned_from_the_whole_recording(made: Path, tmp_path: Path) -> None:
    """Catches a background that is learned only from the frames of --frames, and mattes of other frames that are
    deleted."""
    capture = tmp_path / "capture"
    shutil.copytree(made, capture, ignore=shutil.ignore_patterns(".fourd"), copy_function=shutil.copy2)
    assert make_mattes(Selection(capture, frames="2:4"), MatteSettings(), 1, untracked) == 2
    found = contents(capture)
    assert {Path(name).name for name in found} == {"000002.png", "000003.png"}
    assert make_mattes(Selection(capture, frames="3:6"), MatteSettings(), 1, untracked) == 2
    expected = {name: data for name, data in contents(made).items() if Path(name).stem >= "000002"}
    assert contents(capture) == expected


def test_a_capture_without_motion_is_an_error(tmp_path: Path) -> None:
    """Catches mattes that show only noise, and a traceback, for a capture without a moving subject."""
    capture = write_capture_without_masks(tmp_path, frames=4, size=64)
    for folder in (capture / "images").iterdir():
        first = (folder / "000000.png").read_bytes()
        for path in folder.iterdir():
            path.write_bytes(first)
    with pytest.raises(UserError, match=r"expected a moving subject, got no change in any camera.*chroma"):
        make_mattes(Selection(capture), MatteSettings(), 1, untracked)


def test_inconsistent_views_are_an_error(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a traceback from an empty hull, for example with videos of different scenes or a wrong calibration."""
    capture = write_capture_without_masks(tmp_path, frames=4, size=64)
    for index, folder in enumerate(sorted((capture / "images").iterdir())):
        for path in folder.iterdir():
            picture = np.full((64, 64, 3), 90, np.uint8)
            corner = (index % 2) * 44
            picture[corner : corner + 16, corner : corner + 16] = rng.integers(0, 255, (16, 16, 3))
            assert cv2.imwrite(str(path), picture)
    with pytest.raises(UserError, match=r"expected moving regions that intersect in space, got no intersection"):
        make_mattes(Selection(capture), MatteSettings(), 1, untracked)
