"""Clean plates of captures with known mattes."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.progress import untracked
from fourd.recording.capture import open_capture
from fourd.recording.matting.plates import FOLDER, clean_plate, make_plates
from fourd.recording.matting.selection import Selection
from tests.matting.captures import write_capture_without_masks


@pytest.fixture
def moving_square(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A capture of a textured background with a moving square, a static square, and varying exposure."""
    capture = write_capture_without_masks(tmp_path, frames=1, size=64)
    shutil.rmtree(capture / "images")
    stage = rng.integers(40, 160, (64, 64, 3)).astype(np.float32)
    np.save(tmp_path / "stage.npy", stage)
    for name in ("00", "01", "02", "03", "04", "05", "06", "07"):
        for frame in range(16):
            left = 4 + 2 * frame
            picture, matte = stage * (1 + 0.1 * np.sin(frame)), np.zeros((64, 64), np.uint8)
            matte[20:40, left : left + 12] = 255
            matte[50:58, 50:58] = 255
            picture[matte > 0] = 230
            for kind, content in (("images", picture), ("masks", matte)):
                path = capture / kind / name / f"{frame:06d}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                assert cv2.imwrite(str(path), np.clip(content[..., ::-1] if kind == "images" else content, 0, 255))
    return capture


def test_plate_excludes_subject_and_exposure_changes(moving_square: Path, tmp_path: Path) -> None:
    """Catches ghosts of the subject in the plate, and changes of exposure that distort the plate."""
    capture = open_capture(moving_square)
    plate = clean_plate(capture, 0)
    stage = np.load(tmp_path / "stage.npy")
    assert not plate.seen[52:56, 52:56].any(), "pixels that the subject always covers are holes"
    assert plate.seen[5:45].all()
    assert np.square(plate.rgb.astype(float) - stage)[plate.seen].mean() < 2


def test_a_missing_matte_leaves_no_ghost(moving_square: Path, tmp_path: Path) -> None:
    """Catches a plate from a single pass. In a single pass, a frame with an empty matte adds the subject to the
    plate."""
    cv2.imwrite(str(moving_square / "masks" / "00" / "000007.png"), np.zeros((64, 64), np.uint8))
    plate = clean_plate(open_capture(moving_square), 0)
    stage = np.load(tmp_path / "stage.npy")
    assert np.abs(plate.rgb[22:38, 20:28] - stage[22:38, 20:28]).max() < 12


def test_plates_are_cached_by_key_and_mattes(moving_square: Path) -> None:
    """Catches outdated plates after a change of the input, and plates that are made again without a change."""
    selection = Selection(moving_square)
    assert make_plates(selection, "a", 1, untracked) == 8
    assert make_plates(selection, "a", 1, untracked) == 0
    assert make_plates(selection, "b", 1, untracked) == 8
    matte = moving_square / "masks" / "03" / "000004.png"
    cv2.imwrite(str(matte), np.zeros((64, 64), np.uint8))
    assert make_plates(selection, "b", 1, untracked) == 1, "a matte was edited"
    written = cv2.imread(str(moving_square / FOLDER / "00.png"), cv2.IMREAD_UNCHANGED)
    assert written.shape == (64, 64, 4)
    assert written[54, 54, 3] == 0
    assert written[5, 5, 3] == 255
