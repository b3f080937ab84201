"""Calibration boards: files, patterns and corners."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.recording.boards import CalibrationBoard, charuco_board, draw_board, ink_rectangles, read_board, write_board
from fourd.recording.calibration.chessboard import find_corners

CHARUCO = CalibrationBoard(4, 5, 0.054, 0.0405, "DICT_4X4_1000")
CHESSBOARD = CalibrationBoard(8, 5, 0.03)


@pytest.mark.parametrize("size", [(4, 5), (5, 4), (7, 6)])
@pytest.mark.parametrize("legacy", [False, True])
def test_the_pattern_is_opencv_s(size: tuple[int, int], legacy: bool) -> None:
    """Catches a printed or rendered board that differs from the board that OpenCV detects."""
    board = CalibrationBoard(*size, 0.05, 0.0375, "DICT_5X5_50", legacy_pattern=legacy)
    expected = charuco_board(board).generateImage((size[0] * 112, size[1] * 112), marginSize=0)
    assert np.array_equal(draw_board(board, 112), expected)
    assert np.array_equal(draw_board(replace(board, inverted=True), 112), 255 - expected)


def test_corners_are_where_opencv_finds_them() -> None:
    """Catches ids in the wrong order, and corners that are mirrored or shifted by half a pixel."""
    picture = draw_board(CHARUCO, 60, margin=30)
    pixels, ids, _, _ = cv2.aruco.CharucoDetector(charuco_board(CHARUCO)).detectBoard(picture)
    scale = 60 / CHARUCO.square_m
    expected = CHARUCO.corners[np.ravel(ids), :2] * (scale, -scale) + (30, picture.shape[0] - 30)
    assert len(ids) == CHARUCO.corner_count == 12
    assert np.abs(np.reshape(pixels, (-1, 2)) + 0.5 - expected).max() < 0.25


@pytest.mark.parametrize("size", [(8, 5), (5, 8), (7, 6)])
@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_chessboard_has_one_orientation(size: tuple[int, int], turns: int) -> None:
    """Catches corners of a chessboard that change their order when the board is turned."""
    board = CalibrationBoard(*size, 0.03)
    picture = np.ascontiguousarray(np.rot90(draw_board(board, 40, margin=40), turns))
    found = find_corners(picture, size[0] - 1, size[1] - 1)
    assert found is not None
    upright = board.corners[:, :2] * (40 / 0.03, -40 / 0.03) + (40, 40 + 40 * size[1])
    width, height = 40 * size[0] + 80, 40 * size[1] + 80
    for _ in range(turns):
        upright = np.stack([upright[:, 1], width - upright[:, 0]], axis=1)
        width, height = height, width
    assert np.abs(found.reshape(-1, 2) + 0.5 - upright).max() < 0.1


def test_ink_covers_half_of_a_chessboard() -> None:
    """Catches overlapping rectangles."""
    edges = ink_rectangles(CHESSBOARD)
    area = ((edges[:, 2] - edges[:, 0]) * (edges[:, 3] - edges[:, 1])).sum()
    assert area == pytest.approx(8 * 5 / 2 * 0.03**2)


@pytest.mark.parametrize("board", [CHARUCO, CHESSBOARD, replace(CHARUCO, inverted=True, double_sided=True)])
def test_a_written_board_is_read_back(board: CalibrationBoard, tmp_path: Path) -> None:
    """Catches a value that is lost or rounded in the file."""
    write_board(tmp_path / "board.toml", board)
    assert read_board(tmp_path / "board.toml") == board


GOOD = 'columns = 4\nrows = 5\nsquare_m = 0.05\nmarker_m = 0.04\ndictionary = "DICT_4X4_50"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD.replace("rows = 5", "rows ="), "expected TOML, got"),
        (GOOD.replace("rows = 5\n", ""), "rows: expected a value for a charuco board, got none; add the key"),
        (GOOD.replace("rows", "row"), "row: expected one of .* got 'row'; did you mean 'rows'"),
        (GOOD.replace("0.05", '"5 cm"'), "square_m: expected a number, got '5 cm'"),
        (GOOD.replace("0.05", "nan"), "square_m: expected the side of a square in metres, got nan"),
        (GOOD.replace("0.05", "0"), "square_m: expected the side of a square in metres, got 0; measure it"),
        (GOOD.replace("0.05", "-0.05"), "square_m: expected the side of a square in metres, got -0.05; measure it"),
        (
            GOOD.replace("0.05", "50"),
            "square_m: expected the side of a square in metres, got 50, a square of 50 m; write 0.05 if it is 50 mm, "
            "or 0.5 if it is 50 cm",
        ),
        (
            GOOD.replace("0.05", "2.5"),
            "square_m: .* got 2.5, a square of 2.5 m; write 0.0025 if it is 2.5 mm, or 0.025 if it is 2.5 cm",
        ),
        (
            GOOD.replace("0.04", "40"),
            "marker_m: expected more than 0 and less than square_m, got 40; write 0.04 if it is 40 mm",
        ),
        (GOOD.replace("0.04", "-1"), "marker_m: expected more than 0 and less than square_m, got -1; measure a marker"),
        (GOOD.replace("0.04", "0.05"), "marker_m: expected more than 0 and less than square_m, got 0.05"),
        (GOOD.replace("4X4_50", "4X4_51"), "dictionary: expected a dictionary of OpenCV, got 'DICT_4X4_51'"),
        (GOOD.replace("rows = 5", "rows = 50"), "dictionary: expected at least 100 markers, got 50 in DICT_4X4_50"),
        (GOOD.replace("rows = 5", "rows = 1"), "rows: expected 3 to 100 squares, got 1"),
        (GOOD + 'pattern = "circles"\n', "pattern: expected charuco or chessboard, got 'circles'"),
        (GOOD + "inverted = 1\n", "inverted: expected true or false, got 1"),
        ("columns = 8\nrows = 6\nsquare_m = 0.03\n", "one odd and one even number, got 8 and 6"),
        ("columns = 8\nrows = 5\nsquare_m = 0.03\nlegacy_pattern = true\n", "legacy_pattern: expected one of"),
        ("columns = 8\nrows = 5\nsquare_m = 0.03\ndouble_sided = true\n", "double_sided: expected one of"),
    ],
)
def test_a_wrong_file_is_one_line(text: str, message: str, tmp_path: Path) -> None:
    """Catches an error about a board's file that does not name the file, the key or the fix."""
    path = tmp_path / "board.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as caught:
        read_board(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    """Catches a traceback for a mistyped path."""
    with pytest.raises(UserError, match=r"gone\.toml: expected a board's TOML file"):
        read_board(tmp_path / "gone.toml")
