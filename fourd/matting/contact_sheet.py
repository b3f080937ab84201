"""A picture by which a person judges mattes: what the cameras saw, and what is left of it, side by side in time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.capture import Capture
from fourd.capture.layout import sample_indices
from fourd.files import write_bytes_atomically
from fourd.progress import Track, untracked

Picture = NDArray[np.uint8]
Box = tuple[slice, slice]

MOST_CAMERAS = 8
CELL_HEIGHT = 240
CELL_WIDTH = 240
"""Pixels, at most, of a picture and of its cut-out each."""
MARGIN = 0.12
"""About the mattes' common box, of its longer side: enough to see a limb that no matte has."""
LEAST_ALPHA = 8
"""From which a pixel widens that box: faint leftovers are to be seen."""
GAP_PX = 4
CAPTION_PX = 16
LEAST_WIDTH = 120
"""Of the sheet, for a camera's name."""
SHEET_COLOUR = (32, 32, 32)
CAPTION_COLOUR = (235, 235, 235)
FLAT_COLOURS = ((0, 220, 0), (255, 0, 255), (0, 80, 255))
"""Behind cut-outs: all far from black, white and skin."""
WORST_SHARE = 0.1


def contact_sheet(
    capture: Capture,
    path: Path | str,
    cameras: Sequence[int] | None = None,
    moments: int = 10,
    track: Track = untracked,
) -> None:
    """Write a PNG: a row a camera, a column a moment; a cell is the picture and, below it, the cut-out on flat colour.

    All cells of a row show the box that its mattes fill at these moments, with a margin, or the whole picture where
    they are empty. The flat colour is the one farthest from the subject's. Rows bear the camera's name, cells the
    frame's number in the whole capture. One picture is in memory at a time, beside the sheet.

    Args:
        capture: with mattes.
        path: of the file, whatever its suffix; whole or not at all.
        cameras: indices into ``capture.names``; None for at most 8, evenly chosen.
        moments: at least 1, evenly spread over the selected frames; fewer where there are fewer frames.
        track: for progress.

    Raises:
        UserError: when there are no mattes, or a picture is damaged.
    """
    if moments < 1:
        raise ValueError(f"moments: expected at least 1, got {moments}")
    chosen = sample_indices(len(capture.names), MOST_CAMERAS) if cameras is None else list(cameras)
    frames = sample_indices(capture.frame_count, moments)
    flat = _flat_colour(capture, chosen, frames)
    rows = [_row(capture, camera, frames, flat) for camera in track(chosen, len(chosen), "sheet")]
    width = max(LEAST_WIDTH, *(row.shape[1] for row in rows))
    named = [
        np.concatenate([_caption(f"camera {capture.names[camera]}", width), _padded(row, width)])
        for camera, row in zip(chosen, rows, strict=True)
    ]
    sheet = _stacked(named, axis=0)
    done, content = cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))
    assert done
    write_bytes_atomically(path, content.tobytes())


def _row(capture: Capture, camera: int, frames: Sequence[int], flat: Picture) -> Picture:
    box = _common_box(capture, camera, frames)
    return _stacked([_cell(capture, camera, frame, box, flat) for frame in frames], axis=1)


def _cell(capture: Capture, camera: int, frame: int, box: Box, flat: Picture) -> Picture:
    """Caption, picture and cut-out, one above another."""
    seen = _reduced(capture.image(camera, frame)[box])
    alpha = _reduced(capture.mask(camera, frame)[box])[..., None] / np.float32(255)
    cut = np.asarray(alpha * seen + (1 - alpha) * flat + 0.5, np.uint8)
    caption = _caption(str(capture.frame_numbers[frame]), seen.shape[1])
    return np.concatenate([caption, seen, cut])


def _caption(text: str, width: int) -> Picture:
    strip = np.full((CAPTION_PX, width, 3), SHEET_COLOUR, np.uint8)
    cv2.putText(strip, text, (2, CAPTION_PX - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, CAPTION_COLOUR, 1, cv2.LINE_AA)
    return strip


def _common_box(capture: Capture, camera: int, frames: Sequence[int]) -> Box:
    """Rows and columns of what the camera's mattes fill together; the whole picture where they are empty."""
    view = capture.cameras[camera]
    filled = np.zeros((view.height, view.width), bool)
    for frame in frames:
        filled |= capture.mask(camera, frame) >= LEAST_ALPHA
    left, top, width, height = cv2.boundingRect(filled.astype(np.uint8))
    if width == 0:
        return slice(0, view.height), slice(0, view.width)
    margin = 2 + round(MARGIN * max(width, height))
    rows = slice(max(0, top - margin), min(view.height, top + height + margin))
    return rows, slice(max(0, left - margin), min(view.width, left + width + margin))


def _flat_colour(capture: Capture, cameras: Sequence[int], frames: Sequence[int]) -> Picture:
    """(3,) uint8: of FLAT_COLOURS the one from which even the nearest tenth of the subject's colours are far."""
    frame = frames[len(frames) // 2]
    colours = []
    for camera in cameras:
        subject = capture.image(camera, frame)[capture.mask(camera, frame) > 127]
        colours.append(subject[:: max(1, len(subject) // 2000)])
    values = np.concatenate(colours).astype(np.float32)
    candidates = np.array(FLAT_COLOURS, np.uint8)
    if not len(values):
        return candidates[0]
    away = np.linalg.norm(values[:, None] - candidates.astype(np.float32), axis=-1)
    return candidates[np.argmax(np.quantile(away, WORST_SHARE, axis=0))]


def _reduced(picture: Picture) -> Picture:
    height, width = picture.shape[:2]
    scale = min(1.0, CELL_HEIGHT / height, CELL_WIDTH / width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _padded(picture: Picture, width: int) -> Picture:
    return cv2.copyMakeBorder(
        picture, 0, 0, 0, width - picture.shape[1], cv2.BORDER_CONSTANT, value=SHEET_COLOUR
    ).astype(np.uint8)


def _stacked(pictures: Sequence[Picture], axis: int) -> Picture:
    """Pictures after one another, with gaps; equal along the other axis."""
    parts = []
    for picture in pictures:
        shape = list(picture.shape)
        shape[axis] = GAP_PX
        parts += [picture, np.full(shape, SHEET_COLOUR, np.uint8)]
    return np.concatenate(parts[:-1], axis=axis)
