"""Detection of a calibration board's corners in images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.board_calibration.saddle_points import refine_corners
from fourd.recording.boards import CalibrationBoard, charuco_board
from fourd.recording.calibration.chessboard import find_corners

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

MIN_CORNERS = 6
"""Minimum number of corners of a view. A pose from fewer corners is inaccurate."""
MIN_SPREAD = 0.5
"""Minimum root mean square distance, in squares, of a view's corners from the line that fits them best. Corners on one
line do not determine a pose."""
MARKER_CLEARANCE = 0.95
"""Half the side length of the patch in which a corner is located to sub-pixel accuracy, as a fraction of the distance
from the corner to the nearest marker."""
CHESSBOARD_PATCH = 0.2
"""Half the side length of the patch around a corner of a chessboard, in squares."""
MAX_CHESSBOARD_PX = 1000
"""The search for a chessboard starts in a reduced image, whose longer side has this length in pixels. If the reduced
image shows no chessboard, the full image is not searched, because a search takes longest in an image without a
chessboard.
"""


@dataclass(frozen=True, eq=False)
class BoardView:
    """The corners of a board in one image.

    Attributes:
        camera: index of the camera.
        frame: frame number.
        corners: (N,) ids of the corners, which index :attr:`fourd.recording.boards.CalibrationBoard.corners`.
        pixels: (N, 2) positions in the distorted image; the first pixel's centre is at (0.5, 0.5).
        back: whether the camera sees the back of a double-sided board.
    """

    camera: int
    frame: int
    corners: NDArray[np.intp]
    pixels: Array
    back: bool = False


class BoardDetector:
    """Finds one board in images. The search for a double-sided board also uses the mirrored image."""

    def __init__(self, board: CalibrationBoard) -> None:
        self.board = board
        self._mirrored_first: dict[int, bool] = {}
        self._charuco = None if board.dictionary is None else _make_charuco_detector(board)

    def detect(self, grey: Grey, camera: int, frame: int) -> BoardView | None:
        """Find the board in an image (H, W) uint8. Returns None if too few of the board's corners are visible."""
        positive = 255 - grey if self.board.inverted else grey
        first = self._mirrored_first.get(camera, False)
        for mirrored in (first, not first) if self.board.double_sided else (False,):
            found = self._detect_side(np.ascontiguousarray(positive[:, ::-1]) if mirrored else positive)
            if found is None:
                continue
            self._mirrored_first[camera] = mirrored
            corners, pixels = found
            if mirrored:
                pixels[:, 0] = grey.shape[1] - 1 - pixels[:, 0]
            # The centre of the first pixel has the coordinate 0 in OpenCV and 0.5 in fourd.
            return BoardView(camera, frame, corners, pixels + 0.5, mirrored)
        return None

    def _detect_side(self, grey: Grey) -> tuple[NDArray[np.intp], Array] | None:
        """Return the ids and positions of the corners in OpenCV's pixel coordinates."""
        found = self._detect_chessboard(grey) if self._charuco is None else self._detect_charuco(grey, self._charuco)
        if found is None:
            return None
        corners, rough = found
        flat = self.board.corners[corners, :2] / self.board.square_m
        if not _is_spread(flat):
            return None
        pixels, is_saddle = refine_corners(grey, flat, rough, self._patch_squares)
        kept = corners[is_saddle]
        return (kept, pixels[is_saddle]) if _is_spread(flat[is_saddle]) else None

    @property
    def _patch_squares(self) -> float:
        """Half the side length, in board squares, of the patch in which a corner is located to sub-pixel accuracy. The
        patch does not reach the markers."""
        if self.board.marker_m is None:
            return CHESSBOARD_PATCH
        return MARKER_CLEARANCE * (1 - self.board.marker_m / self.board.square_m) / 2

    def _detect_charuco(self, grey: Grey, detector: cv2.aruco.CharucoDetector) -> tuple[NDArray[np.intp], Array] | None:
        pixels, ids, _, _ = detector.detectBoard(grey)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        return np.ravel(ids).astype(np.intp), np.asarray(pixels, np.float64).reshape(-1, 2)

    def _detect_chessboard(self, grey: Grey) -> tuple[NDArray[np.intp], Array] | None:
        columns, rows = self.board.columns - 1, self.board.rows - 1
        zoom = MAX_CHESSBOARD_PX / max(grey.shape)
        if zoom < 1:
            reduced = np.asarray(cv2.resize(grey, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA), np.uint8)
            if not cv2.checkChessboard(reduced, (columns, rows)) and find_corners(reduced, columns, rows) is None:
                return None
        found = find_corners(grey, columns, rows)
        return None if found is None else (np.arange(columns * rows), found.reshape(-1, 2))


def _is_spread(flat: Array) -> bool:
    """Return True if there are enough corners and they are not nearly on one line. ``flat`` (N, 2) are the corners'
    positions on the board, in squares."""
    if len(flat) < MIN_CORNERS:
        return False
    return bool(np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)[1] >= MIN_SPREAD * np.sqrt(len(flat)))


def _make_charuco_detector(board: CalibrationBoard) -> cv2.aruco.CharucoDetector:
    charuco = cv2.aruco.CharucoParameters()
    charuco.tryRefineMarkers = True
    markers = cv2.aruco.DetectorParameters()
    markers.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.CharucoDetector(charuco_board(board), charuco, markers)
