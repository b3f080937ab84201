"""Cameras of a capture whose images are late or early."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.recording.capture import write_calibration
from fourd.recording.sync.lateness import find_late_cameras
from tests.captures import ring_cameras
from tests.sync.discs import SIZE, film, smooth_paths

FRAMES = 60


@pytest.mark.parametrize("late", [0, 8])
def test_a_late_camera_is_named(late: int, tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a late camera that nobody notices before hours of training, and an alarm for cameras with a common
    trigger."""
    cameras, names = ring_cameras(4, SIZE), ("a", "b", "c", "d")
    write_calibration(tmp_path, names, cameras)
    paths = smooth_paths(rng, FRAMES + late)
    for name, camera in zip(names, cameras, strict=True):
        start = 0 if name == "c" else late
        (tmp_path / "images" / name).mkdir(parents=True)
        for frame, picture in enumerate(film(camera, paths[start : start + FRAMES], rng)):
            cv2.imwrite(str(tmp_path / "images" / name / f"{frame:06d}.png"), picture)
    lines = find_late_cameras(tmp_path)
    if not late:
        assert lines == []
        return
    assert len(lines) == 1
    assert lines[0].startswith(f"{tmp_path}: camera 'c' is late by 8 frames compared with the motion in the other")
    assert "--offset c=8" in lines[0]
