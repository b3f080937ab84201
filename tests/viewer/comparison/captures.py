"""A capture whose cameras and frames are those of the scenes of tests."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fourd.recording.capture import write_calibration
from fourd.scene import SceneManifest

RED = (200, 40, 30)
"""Colour of camera 00. The other cameras are of darker greys."""


def write_flat_capture(folder: Path, manifest: SceneManifest, cameras: int = 2) -> Path:
    """Write a capture whose pictures have one colour each. The blue channel is the number of the frame."""
    names, views = manifest.names[:cameras], manifest.cameras[:cameras]
    write_calibration(folder, list(names), list(views))
    for index, (name, view) in enumerate(zip(names, views, strict=True)):
        (folder / "images" / name).mkdir(parents=True)
        for number in range(max(manifest.frame_numbers) + 1):
            red, green, _ = RED if index == 0 else (10 * index, 10 * index, 0)
            picture = np.full((view.height, view.width, 3), (number, green, red), np.uint8)
            assert cv2.imwrite(str(folder / "images" / name / f"{number:06d}.png"), picture)
    return folder
