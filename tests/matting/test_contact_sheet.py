"""The contact sheet of mattes: its layout, and the visibility of matting errors."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.capture import open_capture
from fourd.recording.matting.contact_sheet import CAPTION_PX, FLAT_COLOURS, write_contact_sheet

Picture = NDArray[np.uint8]


def read(path: Path) -> Picture:
    picture = cv2.imread(str(path))
    assert picture is not None
    return np.asarray(picture[..., ::-1], np.uint8)


def is_flat(picture: Picture) -> NDArray[np.bool_]:
    return np.any([np.all(picture == np.array(colour), axis=-1) for colour in FLAT_COLOURS], axis=0)


def test_cells_contain_the_picture_and_its_cutout(ball_capture: Path, tmp_path: Path) -> None:
    """Catches mattes of another frame, inverted mattes, swapped channels, and a flat background colour that is close to
    the subject's colour."""
    capture = open_capture(ball_capture)
    write_contact_sheet(capture, tmp_path / "sheet.png", cameras=[2], columns=1)
    mask, image = capture.mask(2, 0), capture.image(2, 0)
    left, top, width, height = cv2.boundingRect((mask >= 8).astype(np.uint8))
    sheet = read(tmp_path / "sheet.png")[2 * CAPTION_PX :]
    half = len(sheet) // 2
    margin = (half - height) // 2
    rows, columns = slice(top - margin, top - margin + half), slice(left - margin, left + width + margin)
    cut = columns.stop - columns.start
    np.testing.assert_array_equal(sheet[:half, :cut], image[rows, columns])
    np.testing.assert_array_equal(is_flat(sheet[half:, :cut]), mask[rows, columns] == 0)
    whole = mask[rows, columns] == 255
    np.testing.assert_array_equal(sheet[half:, :cut][whole], image[rows, columns][whole])


def test_rows_are_cameras_and_columns_frames(ball_capture: Path, tmp_path: Path) -> None:
    """Catches empty rows, empty columns, and frames that appear twice in the sheet."""
    capture = open_capture(ball_capture)
    sizes = {}
    for cameras, columns in ((1, 1), (2, 1), (8, 1), (1, 3), (1, 10)):
        write_contact_sheet(capture, tmp_path / "sheet.png", cameras=range(cameras), columns=columns)
        sizes[cameras, columns] = read(tmp_path / "sheet.png").shape[:2]
    write_contact_sheet(capture, tmp_path / "sheet.png", columns=1)
    assert read(tmp_path / "sheet.png").shape[:2] == sizes[8, 1]
    assert sizes[2, 1][0] > 1.7 * sizes[1, 1][0]
    assert sizes[1, 3] == sizes[1, 10]
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.png"]


def test_remnants_far_from_the_subject_are_visible(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a crop that excludes false foreground, or parts of the subject that appear in only one frame."""
    folder = tmp_path / "capture"
    shutil.copytree(ball_capture, folder)
    path = folder / "masks" / "00" / "000002.png"
    mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    mask[0:2, 0:2] = 20
    cv2.imwrite(str(path), mask)
    for name, source in (("clean", ball_capture), ("left", folder)):
        write_contact_sheet(open_capture(source), tmp_path / f"{name}.png", cameras=[0], columns=3)
    assert read(tmp_path / "left.png").shape[0] > read(tmp_path / "clean.png").shape[0] + 4


def test_empty_mattes_show_the_full_picture(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a crash or an empty cell for an empty matte, where the sheet must show that the subject is missing."""
    folder = tmp_path / "capture"
    shutil.copytree(ball_capture, folder)
    for path in (folder / "masks").rglob("*.png"):
        cv2.imwrite(str(path), np.zeros((64, 64), np.uint8))
    write_contact_sheet(open_capture(folder), tmp_path / "sheet.png", cameras=[1], columns=1)
    sheet = read(tmp_path / "sheet.png")[2 * CAPTION_PX :, :64]
    np.testing.assert_array_equal(sheet[:64], open_capture(folder).image(1, 0))
    assert is_flat(sheet[64:]).all()


def test_capture_without_mattes_is_an_error(ball_capture: Path, tmp_path: Path) -> None:
    """Catches an incomplete contact sheet that remains after an error."""
    folder = tmp_path / "capture"
    shutil.copytree(ball_capture, folder)
    shutil.rmtree(folder / "masks")
    with pytest.raises(UserError, match="expected mattes"):
        write_contact_sheet(open_capture(folder), tmp_path / "sheet.png")
    assert not (tmp_path / "sheet.png").exists()
