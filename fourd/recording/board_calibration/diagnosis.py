"""Search for the reason why a board is not found: markers or numbers of squares that differ from the board's file, or
inverted or mirrored images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.boards import CalibrationBoard, charuco_board, dictionary_names, load_dictionary

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

MIN_MARKERS = 4
"""Images with fewer markers than this number are ignored, because so few markers may be false detections."""
MAX_TRIED_SQUARES = 14
"""Board sizes other than the size in the board's file are tried up to this number of columns and of rows."""
INLIER_SQUARES = 0.25
"""Maximum distance of a marker from its expected position on a board, in squares."""
MAX_PX = 800
"""The search for chessboards that differ from the board's file uses reduced images, whose longer side has this length
in pixels."""
FEW_PICTURES = 3
"""Number of images that are searched first.

The other images are searched only if the first images show no board, because the search for all dictionaries is slow.
"""
MAX_TRIALS = 60
"""Number of random samples per homography. Few samples are enough, because most markers are detected correctly."""
MAX_FITTED_PICTURES = 3
ENOUGH_PLACED = 0.9
"""If a board size places at least this fraction of the markers at their expected positions, no further sizes are
tried."""
MAX_CHESSBOARD_PICTURES = 3
"""Maximum number of images in which chessboards of other sizes are searched for. It is small because the search is
slow."""


@dataclass(frozen=True, eq=False)
class MarkerImage:
    """Markers in one image.

    Attributes:
        ids: (M,) ids in the dictionary.
        corners: (M, 4, 2) corners in pixels, clockwise from the upper left, in the image that was searched.
    """

    ids: NDArray[np.intp]
    corners: Array


@dataclass(frozen=True, eq=False)
class _FoundMarkers:
    """Markers of one dictionary, and whether the images were inverted or mirrored to find them."""

    inverted: bool
    mirrored: bool
    dictionary: str
    images: tuple[MarkerImage, ...]


def suggest_fix(board: CalibrationBoard, pictures: Sequence[Grey]) -> str | None:
    """Find the keys and values that the board's file needs to describe the board in the images (H, W) uint8.

    The function tries all dictionaries, many numbers of squares, the inverted board and the mirrored board. The result
    is a text with the keys that must be changed, or None if no board is found.
    """
    few = pictures[:: max(1, len(pictures) // FEW_PICTURES)]
    best = _search_markers(board, few) or (_search_markers(board, pictures) if len(few) < len(pictures) else None)
    if best is None:
        return _suggest_chessboard(board, pictures[:MAX_CHESSBOARD_PICTURES])
    changes = _marker_changes(board, best.dictionary, best.images)
    if changes is None:
        return None
    if best.inverted != board.inverted:
        changes.append(f"inverted = {str(best.inverted).lower()}")
    if best.mirrored and not board.double_sided:
        changes.append("double_sided = true")
    return ", ".join(changes) or None


def measure_marker_ratio(board: CalibrationBoard, pictures: Iterable[Grey]) -> float | None:
    """Measure the ratio of a marker's side to a square's side in images of a ChArUco board. Returns None if too few
    markers are found.

    The homography from the image to the board is fitted only to the markers' centres, so the result does not depend on
    ``board.marker_m``.
    """
    assert board.dictionary is not None
    places = _marker_places(board)
    ratios = []
    for picture, mirrored in product(pictures, (False, True) if board.double_sided else (False,)):
        found = _find_markers(_transform(picture, board.inverted, mirrored), board.dictionary, precise=True)
        known = found.ids < len(places)
        if known.sum() < MIN_MARKERS:
            continue
        centres = found.corners[known].mean(axis=1)
        homography, inliers = cv2.findHomography(centres, places[found.ids[known]], cv2.RANSAC, INLIER_SQUARES)
        if homography is None or inliers.sum() < MIN_MARKERS:
            continue
        kept = found.corners[known][inliers.ravel() > 0]
        flat = cv2.perspectiveTransform(kept.reshape(-1, 1, 2), homography).reshape(-1, 4, 2)
        sides = np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2)
        ratios.append(float(np.median(sides)))
    return float(np.median(ratios)) if ratios else None


def _search_markers(board: CalibrationBoard, pictures: Sequence[Grey]) -> _FoundMarkers | None:
    """Search for markers in the images, and in inverted and mirrored copies. Returns the markers of the dictionary with
    the most detections, or None if no marker is found."""
    best, most = None, 0
    for inverted, mirrored in product((board.inverted, not board.inverted), (False, True)):
        turned = [_transform(picture, inverted, mirrored) for picture in pictures]
        for name in _families():
            found = [each for each in (_find_markers(some, name) for some in turned) if len(each.ids) >= MIN_MARKERS]
            count = sum(len(each.ids) for each in found)
            if count > most:
                best, most = _FoundMarkers(inverted, mirrored, name, tuple(found)), count
    return best


def _transform(picture: Grey, inverted: bool, mirrored: bool) -> Grey:
    turned = 255 - picture if inverted else picture
    return np.ascontiguousarray(turned[:, ::-1]) if mirrored else turned


def _marker_changes(board: CalibrationBoard, name: str, found: Sequence[MarkerImage]) -> list[str] | None:
    """Return the keys and values to change in the board's file, so that the file describes the board in the images.
    Returns None if no board fits the markers in the images."""
    size = _fit_size(board, name, sorted(found, key=lambda each: -len(each.ids))[:MAX_FITTED_PICTURES])
    if size is None:
        return None
    columns, rows, legacy = size
    largest = columns * rows // 2 - 1
    changes = []
    if board.dictionary is None:
        changes.append('pattern = "charuco"')
    if board.dictionary is None or not _contains(board.dictionary, name, largest):
        smallest = next(each for each in _distinct_dictionaries() if _contains(each, name, largest))
        changes.append(f'dictionary = "{smallest}"')
    if (columns, rows) != (board.columns, board.rows):
        changes.append(f"columns = {columns}, rows = {rows}")
    if legacy != board.legacy_pattern:
        changes.append(f"legacy_pattern = {str(legacy).lower()}")
    return changes


def _fit_size(board: CalibrationBoard, name: str, images: Sequence[MarkerImage]) -> tuple[int, int, bool] | None:
    """Find the numbers of columns and rows, and whether the pattern is the legacy pattern, from the positions of the
    markers.

    The values of ``board`` are returned if at least 90% of the markers agree with them. Not all markers need to agree,
    because some may be false detections. Returns None if no values agree with more than half of the markers.
    """
    total = sum(len(each.ids) for each in images)
    sizes = [(board.columns, board.rows, board.legacy_pattern)]
    tried = range(3, MAX_TRIED_SQUARES + 1)
    sizes += sorted(product(tried, tried, (False, True)), key=lambda size: size[0] * size[1])
    available = len(load_dictionary(name).bytesList)
    typical = float(np.median(np.concatenate([each.ids for each in images])))
    best, most = None, total / 2
    for columns, rows, legacy in sizes:
        if not typical < columns * rows // 2 <= available:
            continue
        places = _marker_places(CalibrationBoard(columns, rows, 1.0, 0.5, name, legacy_pattern=legacy))
        count = sum(_count_placed(places, each) for each in images)
        if count > most:
            best, most = (columns, rows, legacy), count
        if most >= ENOUGH_PLACED * total:
            break
    return best


def _count_placed(places: Array, found: MarkerImage) -> int:
    """Count the markers that fit one homography from the marker centres in the image to the marker positions on the
    board."""
    known = found.ids < len(places)
    if known.sum() < MIN_MARKERS:
        return 0
    centres = found.corners[known].mean(axis=1)
    homography, inliers = cv2.findHomography(
        centres, places[found.ids[known]], cv2.RANSAC, INLIER_SQUARES, maxIters=MAX_TRIALS
    )
    return 0 if homography is None else int(inliers.sum())


def _marker_places(board: CalibrationBoard) -> Array:
    """Return the centres (M, 2) of the board's markers by id, in squares."""
    description = charuco_board(board)
    centres = np.stack([np.asarray(corners)[:, :2].mean(axis=0) for corners in description.getObjPoints()])
    places = np.zeros_like(centres)
    places[np.ravel(description.getIds())] = centres
    return np.asarray(places / board.square_m, np.float64)


def _find_markers(picture: Grey, name: str, precise: bool = False) -> MarkerImage:
    """Find the markers whose ids occur exactly once in the image. If ``precise`` is True, lines are fitted to the edges
    of the markers, which takes longer."""
    parameters = cv2.aruco.DetectorParameters()
    if precise:
        # Without refined corners, blurred markers appear up to 7% too small.
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    corners, ids, _ = cv2.aruco.ArucoDetector(load_dictionary(name), parameters).detectMarkers(picture)
    if ids is None:
        return MarkerImage(np.zeros(0, np.intp), np.zeros((0, 4, 2)))
    unique = [index for index, count in Counter(np.ravel(ids).tolist()).items() if count == 1]
    kept = np.isin(np.ravel(ids), unique)
    return MarkerImage(np.ravel(ids)[kept].astype(np.intp), np.concatenate(corners).astype(np.float64)[kept])


def _families() -> list[str]:
    """Return the largest dictionary of each family. Each smaller dictionary of a family contains the first markers of
    the largest dictionary."""
    names = _distinct_dictionaries()
    return [
        name
        for index, name in enumerate(names)
        if not any(_contains(other, name, len(load_dictionary(name).bytesList) - 1) for other in names[index + 1 :])
    ]


def _distinct_dictionaries() -> list[str]:
    """Return the dictionaries from small to large, so that a small dictionary is preferred to a large one with the same
    markers.
    """
    names = [name for name in dictionary_names() if name == name.upper()]
    return sorted(names, key=lambda name: (len(load_dictionary(name).bytesList), name))


def _contains(name: str, other: str, largest: int) -> bool:
    """Return whether two dictionaries have the same markers up to the id ``largest``."""
    first, second = load_dictionary(name), load_dictionary(other)
    if first.markerSize != second.markerSize or min(len(first.bytesList), len(second.bytesList)) <= largest:
        return False
    return bool(np.array_equal(first.bytesList[: largest + 1], second.bytesList[: largest + 1]))


def _suggest_chessboard(board: CalibrationBoard, pictures: Sequence[Grey]) -> str | None:
    """Search the images for a chessboard that differs from ``board``. Returns the keys and values that describe it, to
    be written into the file of ``board``, or None if no such chessboard is found."""
    for picture in pictures:
        zoom = min(1.0, MAX_PX / max(picture.shape))
        reduced = np.asarray(cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA), np.uint8)
        for columns, rows in _chessboard_sizes():
            found, _ = cv2.findChessboardCornersSB(reduced, (columns - 1, rows - 1), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
            if found and (board.dictionary is not None or {columns, rows} != {board.columns, board.rows}):
                pattern = 'pattern = "chessboard", ' if board.dictionary is not None else ""
                return f"{pattern}columns = {columns}, rows = {rows}"
    return None


def _chessboard_sizes() -> Iterator[tuple[int, int]]:
    """Yield the numbers of columns and rows to try. Large boards come first, because a part of a large board looks like
    a small board."""
    tried = range(4, MAX_TRIED_SQUARES + 1)
    sizes = [(columns, rows) for columns in tried for rows in tried if columns > rows]
    yield from sorted(sizes, key=lambda size: -size[0] * size[1])
