"""Boards as PDF files: the true scale, the pattern, both sides, and pages that are too small."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.cli.main import main
from fourd.recording.board_calibration.detection import BoardDetector
from fourd.recording.boards import CalibrationBoard, write_board

BOARD = CalibrationBoard(5, 7, 0.03, 0.0225, "DICT_4X4_50")
MM_PER_POINT = 25.4 / 72


def pages(path: Path) -> tuple[tuple[float, float], list[list[tuple[str, np.ndarray]]]]:
    """The size of a page, and for each page the grey level and (x, y, width, height) of each rectangle, in
    millimetres."""
    text = path.read_bytes().decode("ascii")
    assert text.startswith("%PDF-1.")
    width, height = (float(side) for side in re.findall(r"/MediaBox \[0 0 (\S+) (\S+)\]", text)[0])
    found = []
    for content in re.findall(r"stream\n(.*?)\nendstream", text, re.DOTALL):
        grey, rectangles = "0", []
        for line in content.splitlines():
            if line.endswith(" g"):
                grey = line.split()[0]
            if line.endswith(" re f"):
                rectangles.append((grey, np.array([float(word) for word in line.split()[:4]]) * MM_PER_POINT))
        found.append(rectangles)
    return (width * MM_PER_POINT, height * MM_PER_POINT), found


def rasterize(size: tuple[float, float], rectangles: list[tuple[str, np.ndarray]], px_per_mm: int) -> np.ndarray:
    """Draw the rectangles of the page into an image."""
    height, width = (round(side * px_per_mm) for side in size[::-1])
    picture = np.full((height, width), 255, np.uint8)
    for grey, (x, y, w, h) in rectangles:
        x0, x1, y0, y1 = (round(edge * px_per_mm) for edge in (x, x + w, y, y + h))
        picture[height - y1 : height - y0, x0:x1] = 255 * int(grey)
    return picture


def test_offsets_of_objects_are_right(tmp_path: Path) -> None:
    """Catches a wrong cross-reference table of the PDF, which viewers would have to repair."""
    path = tmp_path / "board.pdf"
    write_board(tmp_path / "board.toml", BOARD)
    assert main(["calibrate", "--board", str(tmp_path / "board.toml"), "--print-board", str(path)]) == 0
    content = path.read_bytes()
    table = int(re.findall(rb"startxref\n(\d+)\n", content)[0])
    assert content[table:].startswith(b"xref\n")
    offsets = [int(row) for row in re.findall(rb"(\d{10}) 00000 n ", content)]
    for number, offset in enumerate(offsets, 1):
        assert content[offset:].startswith(b"%d 0 obj\n" % number)
    length, stream = re.findall(rb"/Length (\d+) >>\nstream\n(.*?)\nendstream", content, re.DOTALL)[0]
    assert int(length) == len(stream)


@pytest.mark.parametrize(("page", "size"), [("A4", (210, 297)), ("a3", (297, 420)), ("300x250", (300, 250))])
def test_squares_are_printed_at_true_scale(page: str, size: tuple[float, float], tmp_path: Path) -> None:
    """Catches a printed square that is not 30 mm, a pattern that is cut off, and a board that is not recognised."""
    path = tmp_path / "board.pdf"
    write_board(tmp_path / "board.toml", BOARD)
    words = ["calibrate", "--board", str(tmp_path / "board.toml"), "--print-board", str(path), "--page", page]
    assert main(words) == 0
    found, (rectangles,) = pages(path)
    assert np.allclose(found, size, atol=1e-3)
    sides = np.array([each[2:] for _, each in rectangles])
    squares = sides[(sides > 29).all(axis=1)]
    assert len(squares) == 18
    assert np.abs(squares - 30).max() < 1e-3
    ruler = sides[sides[:, 1] < 0.5]
    assert np.allclose(ruler[:, 0], 100, atol=1e-3)
    assert all((edges[:2] > 4).all() and (edges[:2] + edges[2:] < np.array(size) - 4).all() for _, edges in rectangles)
    view = BoardDetector(BOARD).detect(rasterize(found, rectangles, 4), 0, 0)
    assert view is not None
    assert len(view.corners) == BOARD.corner_count


def test_the_back_is_mirrored(tmp_path: Path) -> None:
    """Catches a back side whose corners are not behind the corners of the front when the sheet is turned about its long
    edge."""
    board = replace(BOARD, inverted=True, double_sided=True)
    write_board(tmp_path / "board.toml", board)
    path = tmp_path / "board.pdf"
    assert main(["calibrate", "--board", str(tmp_path / "board.toml"), "--print-board", str(path)]) == 0
    size, (front, back) = pages(path)
    first, second = (rasterize(size, side, 4) for side in (front, back))
    views = [BoardDetector(board).detect(some, 0, 0) for some in (first, np.ascontiguousarray(second[:, ::-1]))]
    assert views[0] is not None
    assert views[1] is not None
    assert np.array_equal(views[0].corners, views[1].corners)
    assert np.abs(views[0].pixels - views[1].pixels).max() < 0.5
    # The background of an inverted board is black.
    assert cv2.countNonZero(first[400:800, 200:600]) < 400 * 400 * 0.7


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--page", "100x100"],
            "--page: expected a page for a board of 150 x 210 mm, got 100 x 100 mm; use --page 160x2",
        ),
        (["--page", "B7"], "--page: expected a4, a3, a2, letter or WIDTHxHEIGHT in millimetres, got 'B7'"),
        (["-o", "calibration"], "--print-board: expected no VIDEOS and no -o, got calibration"),
    ],
)
def test_wrong_pages_are_refused(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a board that is scaled to fit the page, or an option that is silently ignored."""
    write_board(tmp_path / "board.toml", BOARD)
    path = tmp_path / "board.pdf"
    assert main(["calibrate", "--board", str(tmp_path / "board.toml"), "--print-board", str(path), *words]) == 2
    assert message in capsys.readouterr().err
    assert not path.exists()
