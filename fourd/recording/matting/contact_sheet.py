"""Contact sheet for visual inspection of mattes: images and cut-outs of several cameras and frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.files import write_bytes_atomically
from fourd.base.progress import Track, untracked
from fourd.recording.capture import Capture
from fourd.recording.capture.layout import sample_indices

Picture = NDArray[np.uint8]
Box = tuple[slice, slice]

MAX_CAMERAS = 8
CELL_HEIGHT = 240
CELL_WIDTH = 240
"""Maximum width of an image or a cut-out on the sheet, in pixels. CELL_HEIGHT is the maximum height."""
MARGIN = 0.12
"""Margin around the bounding box of the mattes, as a fraction of the box's longer side.

Limbs that a matte misses remain visible in the margin.
"""
MIN_ALPHA = 8
"""The bounding box contains all pixels whose matte value (0 to 255) is at least MIN_ALPHA. This limit is low, so that
the box includes faint matte errors."""
GAP_PX = 4
CAPTION_PX = 16
MIN_WIDTH_PX = 120
"""Minimum width of the sheet in pixels, so that captions fit."""
SHEET_COLOUR = (32, 32, 32)
CAPTION_COLOUR = (235, 235, 235)
FLAT_COLOURS = ((0, 220, 0), (255, 0, 255), (0, 80, 255))
"""Candidates for the RGB background colour of cut-outs. All candidates differ from black, white and skin colours."""
NEAREST_QUANTILE = 0.1


def write_contact_sheet(
    capture: Capture,
    path: Path | str,
    cameras: Sequence[int] | None = None,
    columns: int = 10,
    track: Track = untracked,
) -> None:
    """Write a PNG with one row per camera and one column per frame.

    Each tile shows an image above its cut-out. All tiles of a row are cropped to the bounding box of the row's mattes
    plus a margin. If all mattes of a row are empty, its tiles show full images. Cut-outs are composited over the colour
    that differs most from the subject. Captions show camera names and the capture's frame numbers. Only the contact
    sheet and one image are in memory at a time.

    Args:
        capture: capture with mattes.
        path: file to write atomically. It is a PNG file even if the path has another suffix.
        cameras: indices into ``capture.names``, or None for at most 8 evenly spaced cameras.
        columns: number of evenly spaced frames, at least 1. If the capture has fewer frames, all frames are shown.
        track: progress callback.

    Raises:
        UserError: if there are no mattes or an image is damaged.
    """
    if columns < 1:
        raise ValueError(f"columns: expected at least 1, got {columns}")
    chosen = sample_indices(len(capture.names), MAX_CAMERAS) if cameras is None else list(cameras)
    frames = sample_indices(capture.frame_count, columns)
    flat = _flat_colour(capture, chosen, frames)
    rows = [_row(capture, camera, frames, flat) for camera in track(chosen, len(chosen), "sheet")]
    width = max(MIN_WIDTH_PX, *(row.shape[1] for row in rows))
    captioned = [
        np.concatenate([_caption(f"camera {capture.names[camera]}", width), _pad(row, width)])
        for camera, row in zip(chosen, rows, strict=True)
    ]
    sheet = _stack(captioned, axis=0)
    done, content = cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))
    assert done
    write_bytes_atomically(path, content.tobytes())


def _row(capture: Capture, camera: int, frames: Sequence[int], flat: Picture) -> Picture:
    box = _common_box(capture, camera, frames)
    return _stack([_cell(capture, camera, frame, box, flat) for frame in frames], axis=1)


def _cell(capture: Capture, camera: int, frame: int, box: Box, flat: Picture) -> Picture:
    """Return one tile of the sheet: caption, image and cut-out, stacked vertically."""
    picture = _fit_cell(capture.image(camera, frame)[box])
    alpha = _fit_cell(capture.mask(camera, frame)[box])[..., None] / np.float32(255)
    cutout = np.asarray(alpha * picture + (1 - alpha) * flat + 0.5, np.uint8)
    caption = _caption(str(capture.frame_numbers[frame]), picture.shape[1])
    return np.concatenate([caption, picture, cutout])


def _caption(text: str, width: int) -> Picture:
    strip = np.full((CAPTION_PX, width, 3), SHEET_COLOUR, np.uint8)
    cv2.putText(strip, text, (2, CAPTION_PX - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, CAPTION_COLOUR, 1, cv2.LINE_AA)
    return strip


def _common_box(capture: Capture, camera: int, frames: Sequence[int]) -> Box:
    """Return the bounding box of a camera's mattes plus a margin, as slices, or the full image if all mattes are
    empty."""
    view = capture.cameras[camera]
    filled = np.zeros((view.height, view.width), bool)
    for frame in frames:
        filled |= capture.mask(camera, frame) >= MIN_ALPHA
    left, top, width, height = cv2.boundingRect(filled.astype(np.uint8))
    if width == 0:
        return slice(0, view.height), slice(0, view.width)
    margin = 2 + round(MARGIN * max(width, height))
    rows = slice(max(0, top - margin), min(view.height, top + height + margin))
    return rows, slice(max(0, left - margin), min(view.width, left + width + margin))


def _flat_colour(capture: Capture, cameras: Sequence[int], frames: Sequence[int]) -> Picture:
    """Choose the colour (3,) uint8 of FLAT_COLOURS that differs most from the subject.

    For each candidate, d is the 10% quantile of the RGB distances between the candidate and the subject's pixels: a
    tenth of the pixels are closer to the candidate than d. The candidate with the largest d is chosen. If the subject
    has no pixels, the first candidate is chosen.
    """
    frame = frames[len(frames) // 2]
    colours = []
    for camera in cameras:
        subject = capture.image(camera, frame)[capture.mask(camera, frame) > 127]
        colours.append(subject[:: max(1, len(subject) // 2000)])
    values = np.concatenate(colours).astype(np.float32)
    candidates = np.array(FLAT_COLOURS, np.uint8)
    if not len(values):
        return candidates[0]
    distance = np.linalg.norm(values[:, None] - candidates.astype(np.float32), axis=-1)
    return candidates[np.argmax(np.quantile(distance, NEAREST_QUANTILE, axis=0))]


def _fit_cell(picture: Picture) -> Picture:
    height, width = picture.shape[:2]
    scale = min(1.0, CELL_HEIGHT / height, CELL_WIDTH / width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _pad(picture: Picture, width: int) -> Picture:
    return cv2.copyMakeBorder(
        picture, 0, 0, 0, width - picture.shape[1], cv2.BORDER_CONSTANT, value=SHEET_COLOUR
    ).astype(np.uint8)


def _stack(pictures: Sequence[Picture], axis: int) -> Picture:
    """Concatenate images along ``axis``, with gaps between them.

    Along the other image axis, all images must have the same size.
    """
    parts = []
    for picture in pictures:
        shape = list(picture.shape)
        shape[axis] = GAP_PX
        parts += [picture, np.full(shape, SHEET_COLOUR, np.uint8)]
    return np.concatenate(parts[:-1], axis=axis)
