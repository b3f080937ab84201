"""Calibration boards: ChArUco boards and chessboards, their files, their corners and their patterns.

Board coordinates are in metres. The origin is the board's lower left corner. As seen from the front, x points right
(from column to column), y points up (from row to row), and z points from the board towards the viewer.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, fields
from difflib import get_close_matches
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.limits import read_text_limited

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

MAX_SQUARES = 100
MAX_SIDE_M = 1.0
"""Maximum side of a square in metres. A larger number is probably in millimetres or centimetres."""
MIN_CHARUCO_SQUARES = 3
MIN_CHESSBOARD_SQUARES = 4


@dataclass(frozen=True)
class CalibrationBoard:
    """A ChArUco board or a chessboard.

    Attributes:
        columns: number of squares along x, including squares at the edges.
        rows: number of squares along y, including squares at the edges.
        square_m: side of a square in metres.
        marker_m: side of a marker in metres, or None for a chessboard.
        dictionary: name of the markers' dictionary in OpenCV, such as DICT_4X4_50, or None for a chessboard.
        inverted: whether dark and bright are exchanged.
        double_sided: whether the back shows the mirrored pattern, so that each corner is at the same point on both
            sides. Only boards with markers can be double-sided, because the markers distinguish the front from the
            back.
        legacy_pattern: whether the board has the pattern of OpenCV before version 4.6, which differs from the current
            one only if ``rows`` is even.

    Raises:
        ValueError: if a value is invalid. The message starts with the name of the value.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float | None = None
    dictionary: str | None = None
    inverted: bool = False
    double_sided: bool = False
    legacy_pattern: bool = False

    def __post_init__(self) -> None:
        least = MIN_CHARUCO_SQUARES if self.dictionary else MIN_CHESSBOARD_SQUARES
        for name in ("columns", "rows"):
            value = getattr(self, name)
            if not least <= value <= MAX_SQUARES:
                raise ValueError(f"{name}: expected {least} to {MAX_SQUARES} squares, got {value}; count the squares")
        problem = side_problem(self.square_m)
        if problem is not None:
            raise ValueError(f"square_m: {problem}")
        if self.dictionary is None:
            if self.double_sided:
                raise ValueError(
                    "double_sided: expected a ChArUco board, got a chessboard, whose back looks like its front; use "
                    "markers, or remove double_sided"
                )
            if (self.columns + self.rows) % 2 == 0:
                raise ValueError(
                    f"columns and rows: expected one odd and one even number, got {self.columns} and {self.rows}; such "
                    "a chessboard looks the same after half a turn; cover one row of squares, or use a ChArUco board"
                )
            return
        if self.marker_m is None or not 0 < self.marker_m < self.square_m:
            got = "none" if self.marker_m is None else f"{self.marker_m:g}"
            fix = _other_units(self.marker_m) if self.marker_m and self.marker_m > MAX_SIDE_M else "measure a marker"
            raise ValueError(f"marker_m: expected more than 0 and less than square_m, got {got}; {fix}")
        if self.dictionary not in dictionary_names():
            near = get_close_matches(self.dictionary, dictionary_names(), 1, 0.0)[0]
            raise ValueError(
                f"dictionary: expected a dictionary of OpenCV, got '{self.dictionary}'; did you mean '{near}'?"
            )
        available = len(load_dictionary(self.dictionary).bytesList)
        if self.columns * self.rows // 2 > available:
            raise ValueError(
                f"dictionary: expected at least {self.columns * self.rows // 2} markers, got {available} in "
                f"{self.dictionary}; use a larger dictionary or a smaller board"
            )

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the board in metres."""
        return self.columns * self.square_m, self.rows * self.square_m

    @property
    def corner_count(self) -> int:
        """Number of inner corners."""
        return (self.columns - 1) * (self.rows - 1)

    @property
    def corners(self) -> Array:
        """Positions (N, 3) of the inner corners in metres.

        ChArUco corners are ordered by OpenCV's corner ids. Chessboard corners are ordered row by row, from the lowest
        row.
        """
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        if self.dictionary is not None:
            y = self.rows - y
        flat = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
        return self.square_m * flat.astype(np.float64)

    def describe(self) -> str:
        """Return a short description of the board, for messages."""
        kind = f"ChArUco board ({self.dictionary})" if self.dictionary else "chessboard"
        return f"{kind} of {self.columns} x {self.rows} squares of {1e3 * self.square_m:g} mm"


def side_problem(side_m: float) -> str | None:
    """Return what is wrong with the side of a square in metres, or None if it is plausible. The answer does not name
    the value's option or key."""
    if not (math.isfinite(side_m) and side_m > 0):
        return f"expected the side of a square in metres, got {side_m:g}; measure it"
    if side_m > MAX_SIDE_M:
        return (
            f"expected the side of a square in metres, got {side_m:g}, a square of {side_m:g} m; {_other_units(side_m)}"
        )
    return None


def _other_units(number: float) -> str:
    return f"write {number / 1000:g} if it is {number:g} mm, or {number / 100:g} if it is {number:g} cm"


def dictionary_names() -> list[str]:
    """Return the names of OpenCV's marker dictionaries, in alphabetical order."""
    return [name for name in dir(cv2.aruco) if name.startswith("DICT_")]


def load_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Return a marker dictionary by its name in OpenCV."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def charuco_board(board: CalibrationBoard) -> cv2.aruco.CharucoBoard:
    """Return OpenCV's object for a ChArUco board. In OpenCV's board coordinates, the origin is at the upper left and y
    points down."""
    assert board.dictionary is not None
    assert board.marker_m is not None
    found = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square_m, board.marker_m, load_dictionary(board.dictionary)
    )
    found.setLegacyPattern(board.legacy_pattern)
    return found


def read_board(path: Path) -> CalibrationBoard:
    """Read a board from a TOML file with the attributes of :class:`CalibrationBoard` as keys.

    The key ``pattern`` is "charuco" or "chessboard". If it is missing, a file with ``dictionary`` or ``marker_m``
    describes a ChArUco board, and any other file a chessboard.

    Raises:
        UserError: if the file is missing or not TOML, or a key is unknown, missing or invalid.
    """
    try:
        data = tomllib.loads(read_text_limited(path))
    except OSError as error:
        raise UserError(f"{path}: expected a board's TOML file, got '{error.strerror}'; check the path") from error
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected TOML, got '{error}'; correct the file") from error
    kinds = {field.name: field.type for field in fields(CalibrationBoard)}
    pattern = data.pop("pattern", "charuco" if {"dictionary", "marker_m"} & data.keys() else "chessboard")
    if pattern not in ("charuco", "chessboard"):
        raise UserError(f"{path}: pattern: expected charuco or chessboard, got '{pattern}'; correct the value")
    needed = {"columns", "rows", "square_m"} | ({"marker_m", "dictionary"} if pattern == "charuco" else set())
    for key in data:
        if key not in kinds or (pattern == "chessboard" and key not in needed | {"inverted"}):
            known = sorted(kinds) if pattern == "charuco" else sorted(needed | {"inverted"})
            near = get_close_matches(key, known, 1, 0.0)[0]
            raise UserError(
                f"{path}: {key}: expected one of {', '.join(known)} for a {pattern} board, got '{key}'; did you mean "
                f"'{near}'?"
            )
    for key in sorted(needed - data.keys()):
        raise UserError(f"{path}: {key}: expected a value for a {pattern} board, got none; add the key")
    for key, value in data.items():
        _check_type(f"{path}: {key}", str(kinds[key]), value)
    try:
        return CalibrationBoard(**data)
    except ValueError as error:
        raise UserError(f"{path}: {error}") from error


def write_board(path: Path, board: CalibrationBoard) -> None:
    """Write a board's TOML file, which :func:`read_board` reads."""
    lines = [f'pattern = "{"charuco" if board.dictionary else "chessboard"}"']
    for field in fields(board):
        value = getattr(board, field.name)
        if value is None or value is False:
            continue
        text = "true" if value is True else f'"{value}"' if isinstance(value, str) else repr(value)
        lines.append(f"{field.name} = {text}")
    write_text_atomically(path, "\n".join(lines) + "\n")


def ink_rectangles(board: CalibrationBoard) -> Array:
    """Return the rectangles (N, 4) to print, as x0, y0, x1, y1 in board coordinates, in metres.

    They do not overlap. They are dark on a bright background, or bright on a dark one if the board is inverted.
    """
    column, row = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    squares = np.stack([column, row], axis=-1).reshape(-1, 2).astype(np.float64)
    if board.dictionary is None:
        dark = squares[squares.sum(axis=1) % 2 == 0]
        return board.square_m * np.hstack([dark, dark + 1])
    description, dictionary = charuco_board(board), load_dictionary(board.dictionary)
    side = dictionary.markerSize + 2
    rectangles, height = [], board.size_m[1]
    marked = set()
    for marker, corners in zip(
        np.ravel(description.getIds()), map(np.asarray, description.getObjPoints()), strict=True
    ):
        left, top = corners[:, 0].min(), height - corners[:, 1].min()
        cell = (corners[:, 0].max() - left) / side
        marked.add((int(left / board.square_m), int((top - cell) / board.square_m)))
        for i, j in np.argwhere(dictionary.generateImageMarker(int(marker), side) == 0):
            rectangles.append([left + j * cell, top - (i + 1) * cell, left + (j + 1) * cell, top - i * cell])
    dark = np.array([square for square in squares if tuple(square.astype(int)) not in marked])
    return np.vstack([board.square_m * np.hstack([dark, dark + 1]), rectangles])


def draw_board(board: CalibrationBoard, pixels_per_square: int, margin: int = 0) -> Grey:
    """Draw the front of the board as an image (H, W), with a blank margin of ``margin`` pixels on each side."""
    scale = pixels_per_square / board.square_m
    height, width = (round(scale * side) + 2 * margin for side in board.size_m[::-1])
    picture = np.full((height, width), 255, np.uint8)
    edges = np.round(ink_rectangles(board) * scale).astype(int) + margin
    for x0, y0, x1, y1 in edges:
        picture[height - y1 : height - y0, x0:x1] = 0
    return 255 - picture if board.inverted else picture


def _check_type(where: str, kind: str, value: object) -> None:
    """Raise UserError if a value does not have the type of its field."""
    expected, matches = "a string", isinstance(value, str)
    if kind == "bool":
        expected, matches = "true or false", isinstance(value, bool)
    elif kind == "int":
        expected, matches = "a whole number", isinstance(value, int) and not isinstance(value, bool)
    elif kind.startswith("float"):
        expected, matches = "a number", isinstance(value, int | float) and not isinstance(value, bool)
    if not matches:
        raise UserError(f"{where}: expected {expected}, got {value!r}; correct the value")
