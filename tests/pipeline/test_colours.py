"""The stage that measures colour differences, on a textured room whose cameras have different gains."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fourd.capture import write_calibration
from fourd.formats.picture import write_picture
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.cameras.colours import ColourFiles, run_colours
from fourd.training.cameras.measured_colours import read_measured_colours
from fourd.training.cameras.selection import DataSelection
from tests.calibration.rooms import Room, room_cameras

NAMES = ("01", "02", "03", "04")
GAINS = (0.8, 1.0, 1.05, 1.1)


def write_room(folder: Path, gains: tuple[float, ...]) -> Path:
    cameras = room_cameras(len(NAMES), 240, 180)
    room = Room(np.random.default_rng(0))
    write_calibration(folder, list(NAMES), cameras)
    for name, camera, gain in zip(NAMES, cameras, gains, strict=True):
        (folder / "images" / name).mkdir(parents=True)
        bgr = (room.picture(camera)[..., ::-1] * np.float32(0.8 * gain)).clip(0, 255).astype(np.uint8)
        write_picture(folder / "images" / name / "000000.png", np.ascontiguousarray(bgr))
    return folder


@pytest.mark.parametrize("gains", [GAINS, (1.0, 1.0, 1.0, 1.0)])
def test_gains_of_cameras_are_measured(tmp_path: Path, gains: tuple[float, ...]) -> None:
    """Catches images that are matched with the colours of other cameras, and a correction of equal cameras."""
    capture, run = write_room(tmp_path / "room", gains), tmp_path / "run"
    run_colours(ColourFiles(capture, run), DataSelection(test_views=("02",)), Context())
    found = read_measured_colours(run)
    assert found is not None
    assert found.differ == (gains == GAINS)
    if found.differ:
        grey = [float(each[0, 0] * 0.5 + each[0, 3]) for each in found.maps.values()]
        assert np.allclose(np.array(grey) / grey[1], np.array(gains) / gains[1], atol=0.03)
