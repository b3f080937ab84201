"""What the frames of a video look like: size, shape of the pixels, rotation, transfer function and transparency."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av

from fourd.base.errors import UserError
from fourd.recording.capture.streams.index import MAX_ASPECT
from fourd.recording.capture.streams.picture import has_alpha, shown_size, transfer_of, turn_of

MIN_STRETCH = Fraction(1, 500)
"""Pixels whose width and height differ by less than this fraction count as square."""


@dataclass(frozen=True)
class Appearance:
    """What the first frame of a video looks like.

    Attributes:
        stored_size: width and height of the stored frame in pixels.
        size: width and height in pixels after the frame is stretched to square pixels and turned upright.
        aspect: width of a stored pixel divided by its height.
        turn: angle in degrees by which the frame must be turned counter-clockwise to be upright.
        transfer: "HLG" or "PQ" for HDR video, otherwise "".
        is_marked: whether the frame is marked as interlaced.
        notes: statements for the user.
    """

    stored_size: tuple[int, int]
    size: tuple[int, int]
    aspect: Fraction
    turn: int
    transfer: str
    is_marked: bool
    notes: tuple[str, ...]


def look_at(path: Path, frame: av.VideoFrame, aspect: Fraction) -> Appearance:
    """Describe a video by its first frame and the ``aspect`` of its pixels.

    Raises:
        UserError: if the metadata mirrors the frames, turns them by an angle that is not a multiple of 90 degrees, or
            gives pixels an impossible shape.
    """
    turn = turn_of(frame)
    if turn is None:
        raise UserError(
            f"{path}: expected frames turned by a multiple of 90 degrees and not mirrored, got another display "
            f"matrix; rotate the frames with: ffmpeg -i {path.name} -crf 12 upright-{path.name}"
        )
    if not Fraction(1, MAX_ASPECT) <= aspect <= MAX_ASPECT:
        raise UserError(
            f"{path}: expected pixels that are at most {MAX_ASPECT} times as wide as high, or as high as wide, got the "
            f"aspect ratio {aspect.numerator}:{aspect.denominator}; make the pixels square with: "
            f"ffmpeg -i {path.name} -vf setsar=1 -crf 12 square-{path.name}"
        )
    if abs(aspect - 1) < MIN_STRETCH:
        aspect = Fraction(1)
    width, height = shown_size(frame.width, frame.height, aspect)
    notes: tuple[str, ...] = ()
    if has_alpha(frame) and not frame.format.has_palette:
        notes = ("frames have an alpha channel: transparent parts are black",)
    size = (height, width) if turn % 180 else (width, height)
    stored = (frame.width, frame.height)
    return Appearance(stored, size, aspect, turn, transfer_of(frame), bool(frame.interlaced_frame), notes)


def check_size(path: Path, frame: av.VideoFrame, number: int, stored: tuple[int, int]) -> None:
    """Raise UserError if the frame ``number`` does not have the size ``stored`` of frame 0."""
    if (frame.width, frame.height) != stored:
        raise UserError(
            f"{path}: expected frames of {stored[0]} x {stored[1]} pixels like frame 0, got {frame.width} x "
            f"{frame.height} in frame {number}; record or export the video at one size"
        )
