"""Draw the visual hulls that are carved from captures with errors (docs/figures/guide/failures.jpg).

python tools/figures/failures.py docs/figures/guide/failures.jpg
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.reconstruction.carving.bounds import Bounds, find_bounds
from fourd.reconstruction.carving.carve import carve_frame
from fourd.recording.capture import Capture, open_capture
from fourd.recording.synth.generate import make_synthetic

Picture = NDArray[np.uint8]

FRAMES, CAMERAS, SIZE = 12, 12, 320
SHOWN, BROKEN, OTHER = 0, 4, 9
"""Indices of three cameras: SHOWN is the camera whose image the figure shows, BROKEN is the camera with an error, and
OTHER is the camera whose calibration is exchanged with that of BROKEN."""
LATE_FRAMES = 3
POINT_BGR = (60, 160, 255)


@dataclass(frozen=True)
class Case:
    """The mattes and cameras from which one hull is carved, and the title of its image."""

    title: str
    masks: list[Picture]
    cameras: list[Camera]


def main(out: tyro.conf.Positional[Path]) -> None:
    """Make a synthetic capture, carve its visual hull with and without errors in the calibration and the mattes, and
    write the figure to ``out``.
    """
    with tempfile.TemporaryDirectory() as folder:
        make_synthetic(Path(folder) / "capture", frames=FRAMES, cameras=CAMERAS, size=SIZE)
        make_synthetic(Path(folder) / "other", frames=FRAMES, cameras=CAMERAS, size=SIZE, seed=7)
        capture, other = open_capture(Path(folder) / "capture"), open_capture(Path(folder) / "other")
        bounds = find_bounds(capture)
        pictures = [draw(capture.image(SHOWN, 0), case, bounds) for case in cases(capture, other)]
    rows = [np.concatenate(pictures[start : start + 3], axis=1) for start in (0, 3)]
    out.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(out), np.concatenate(rows), [cv2.IMWRITE_JPEG_QUALITY, 88])


def cases(capture: Capture, other: Capture) -> list[Case]:
    """Return the correct capture, and five captures with one error each."""
    cameras = list(capture.cameras)
    masks = [matte(capture, camera, 0) for camera in range(CAMERAS)]

    def with_mask(mask: Picture) -> list[Picture]:
        return [mask if camera == BROKEN else each for camera, each in enumerate(masks)]

    rows = np.flatnonzero(masks[BROKEN].any(axis=1))
    middle = rows[0] + 2 * len(rows) // 3
    cut = masks[BROKEN].copy()
    cut[middle:] = 0
    exchanged = list(cameras)
    exchanged[BROKEN], exchanged[OTHER] = cameras[OTHER], cameras[BROKEN]
    return [
        Case("correct", masks, cameras),
        Case(f"one camera {LATE_FRAMES} frames late", with_mask(matte(capture, BROKEN, LATE_FRAMES)), cameras),
        Case("legs missing in one matte", with_mask(cut), cameras),
        Case("two calibrations exchanged", masks, exchanged),
        Case("one view upside down", with_mask(np.ascontiguousarray(masks[BROKEN][::-1, ::-1])), cameras),
        Case("mattes of another recording", [matte(other, camera, 5) for camera in range(CAMERAS)], cameras),
    ]


def matte(capture: Capture, camera: int, frame: int) -> Picture:
    mask = capture.mask(camera, frame)
    assert mask is not None
    return np.asarray(mask, np.uint8)


def draw(picture: Picture, case: Case, bounds: Bounds) -> Picture:
    """Draw the hull's points over the greyscale ``picture`` of the camera SHOWN. Returns (H, W, 3) BGR."""
    grey = cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2BGR)
    canvas = np.asarray(grey // 2 + 40, np.uint8)
    note = ""
    try:
        points = carve_frame(case.masks, case.cameras, bounds, points=12000).xyz
    except UserError:
        points, note = np.zeros((0, 3), np.float32), ": the hull is empty"
    camera = case.cameras[SHOWN]
    seen = points @ camera.rotation.T + camera.translation
    pixels = seen @ camera.intrinsics.T
    for x, y in pixels[:, :2] / pixels[:, 2:]:
        cv2.circle(canvas, (round(float(x) * 4), round(float(y) * 4)), 4, POINT_BGR, -1, cv2.LINE_AA, 2)
    cv2.putText(canvas, case.title + note, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
    return cv2.copyMakeBorder(canvas, 0, 4, 0, 4, cv2.BORDER_CONSTANT, value=(255, 255, 255))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
