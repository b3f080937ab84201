"""Corrections that the user paints on single images: strokes or whole masks of the subject and the background.

Painted pixels get log-odds that outweigh all other evidence. Because the visual hull is carved from the log-odds of all
views, the strokes correct the other views of the frame as well. Optical flow propagates the strokes to neighbouring
frames of the camera, but only to pixels whose colour has not changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.capture import Capture
from fourd.recording.capture.decoding import decode_alpha, decode_matte
from fourd.recording.capture.layout import select_views
from fourd.recording.capture.reader import undistortion_maps
from fourd.recording.matting.mask_files import require_size
from fourd.recording.matting.motion.sampling import flow_field, reduce_picture

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

SUBJECT, BACKGROUND = 204, 51
"""Pixels of a painted image with a grey value of at least SUBJECT are white strokes and mark the subject. Pixels with a
grey value of at most BACKGROUND are black strokes and mark the background. Other pixels are unknown."""
PAINTED_LOG_ODDS = np.float32(16.0)
REACH_FRAMES = 12
MAX_COLOUR_CHANGE = 24
"""A stroke is propagated only to pixels whose 8-bit values change by at most this amount along the optical flow."""


@dataclass(frozen=True)
class Paint:
    """A painted image of one camera and frame.

    Attributes:
        camera: camera name.
        frame: index of the frame in the whole capture.
        path: PNG file: white = subject, black = background, grey or transparent = unknown.
    """

    camera: str
    frame: int
    path: Path


@dataclass(frozen=True, eq=False)
class Strokes:
    """Painted log-odds of one camera and frame.

    Attributes:
        camera: index of the camera.
        frame: index of the frame in the whole capture.
        log_odds: (h, w) positive for the subject, negative for the background, 0 where nothing is painted.
    """

    camera: int
    frame: int
    log_odds: Floats


def parse_paint(text: str) -> Paint:
    """Parse ``CAM:FRAME=FILE``.

    Raises:
        UserError: if the text does not have this format.
    """
    place, _, path = text.partition("=")
    camera, _, frame = place.rpartition(":")
    if not (camera and frame.isdecimal() and path):
        raise UserError(f"--paint: expected CAM:FRAME=FILE.png, such as cam02:40=mask.png, got '{text}'")
    return Paint(camera, int(frame), Path(path))


def read_strokes(paints: Sequence[Paint], capture: Capture, cameras: Sequence[Camera]) -> list[Strokes]:
    """Read painted images at the size of the reduced ``cameras``.

    Args:
        paints: painted images, which match the recorded images pixel for pixel.
        capture: the whole capture.
        cameras: undistorted cameras of the size at which log-odds are computed.

    Raises:
        UserError: if a camera or frame is unknown, or a file is missing, is damaged, has a wrong size, or has no
            strokes.
    """
    strokes = []
    for paint in paints:
        select_views([paint.camera], capture.names, "--paint")
        if paint.frame >= capture.frame_count:
            raise UserError(
                f"--paint {paint.camera}:{paint.frame}: expected a frame from 0 to {capture.frame_count - 1}, got "
                f"{paint.frame}; count frames from 0"
            )
        index = capture.names.index(paint.camera)
        stored = capture.distorted_cameras[index]
        value, alpha = decode_matte(paint.path), decode_alpha(paint.path)
        require_size(value, paint.path, stored.width, stored.height, paint.camera)
        label = np.where(value >= SUBJECT, 1, np.where(value <= BACKGROUND, -1, 0)) * (alpha > 127)
        if not label.any():
            raise UserError(
                f"{paint.path}: expected white or black strokes, got only grey or transparent pixels; paint the "
                "subject white and the background black"
            )
        picture = label.astype(np.float32)
        if stored.distortion is not None:
            maps = undistortion_maps(stored)
            picture = np.asarray(cv2.remap(picture, maps[0], maps[1], cv2.INTER_NEAREST), np.float32)
        size = (cameras[index].width, cameras[index].height)
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
        strokes.append(Strokes(index, paint.frame, PAINTED_LOG_ODDS * picture))
    return strokes


def strokes_in_frame(
    strokes: Sequence[Strokes], capture: Capture, cameras: Sequence[Camera], frame: int
) -> list[Floats | None]:
    """Return the painted log-odds (h, w) of one frame in each camera, or None in cameras that have no strokes on nearby
    frames."""
    found: list[Floats | None] = [None] * len(cameras)
    for each in sorted(strokes, key=lambda stroke: -abs(stroke.frame - frame)):
        distance = abs(each.frame - frame)
        if distance > REACH_FRAMES:
            continue
        odds = each.log_odds
        if distance:
            odds = _carried(each, capture, cameras[each.camera], frame)
        before = found[each.camera]
        # The loop goes from the farthest to the nearest frames, so that strokes on near frames replace strokes on far
        # frames.
        found[each.camera] = odds if before is None else np.where(odds != 0, odds, before)
    return found


def _carried(strokes: Strokes, capture: Capture, camera: Camera, frame: int) -> Floats:
    """Propagate strokes to another frame by optical flow. The log-odds become weaker with the distance between the
    frames, and are 0 where the colours of the two frames do not match."""
    target = reduce_picture(capture.image(strokes.camera, frame), camera)
    source = reduce_picture(capture.image(strokes.camera, strokes.frame), camera)
    flow = flow_field(target, source)
    x, y = np.meshgrid(np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32))
    x, y = x + flow[..., 0], y + flow[..., 1]
    colours = cv2.remap(source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    odds = np.asarray(cv2.remap(strokes.log_odds, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT), np.float32)
    is_same = np.abs(colours.astype(np.int16) - target).max(axis=-1) <= MAX_COLOUR_CHANGE
    weight = np.float32(1 - abs(strokes.frame - frame) / (REACH_FRAMES + 1))
    return np.where(is_same, weight * odds, np.float32(0))
