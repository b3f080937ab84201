"""What the names and headers of a capture's images show: lost frames, and images that are turned differently."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

from fourd.recording.capture.calibration import Calibration
from fourd.recording.capture.decoding import PictureHeader, check_orientation
from fourd.recording.capture.layout import find_pictures
from fourd.recording.capture.pictures.bits import check_bits
from fourd.recording.capture.pictures.orientation import check_turned

MAX_GAPS = 5
"""Maximum number of gaps that a warning lists."""


def describe_gaps(folder: Path, frames: Sequence[str]) -> list[str]:
    """Return a warning of frame numbers that are missing in all cameras of ``folder``; empty if there are none."""
    if len(frames) < 3 or not all(frame.isdecimal() for frame in frames):
        return []
    numbers = [int(frame) for frame in frames]
    step = min(after - before for before, after in pairwise(numbers))
    missing = [str(before + step) for before, after in pairwise(numbers) if after - before != step]
    if step <= 0 or not missing:
        return []
    more = f" and {len(missing) - MAX_GAPS} more" if len(missing) > MAX_GAPS else ""
    return [
        f"{folder}: frames are missing at {', '.join(missing[:MAX_GAPS])}{more}; the frames before and after each gap "
        "count as consecutive"
    ]


class PictureCheck:
    """Checks that all images of a camera are turned by the same EXIF orientation, as its calibration is, and that they
    use all their bits."""

    def __init__(self) -> None:
        self._orientations: dict[str, int] = {}

    def check(self, file: Path, header: PictureHeader, calibration: Calibration | None) -> None:
        """Check one image in the folder of a camera. Raises UserError if the first image of the camera does not fit
        the calibration or its images are almost black, or if another image has another orientation."""
        name = file.parent.name
        if name in self._orientations:
            check_orientation(file, header.orientation, self._orientations[name])
            return
        self._orientations[name] = header.orientation
        check_bits([file.with_name(entry) for entry in find_pictures(file.parent).values()])
        if calibration is not None:
            width, height = calibration.width or header.size[0], calibration.height or header.size[1]
            camera = None
            with suppress(ValueError):
                camera = calibration.camera(width, height)
            if camera is not None:
                check_turned(name, camera, file, header)
