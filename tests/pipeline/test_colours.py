"""The stage that measures colour differences, on a textured room whose cameras have different gains."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.formats.picture import write_picture
from fourd.pipeline.make import create_run
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.cameras.colours import ColourFiles, run_colours
from fourd.reconstruction.training.cameras.measured_colours import read_measured_colours
from fourd.reconstruction.training.cameras.selection import DataSelection
from fourd.reconstruction.training.config import RefineConfig
from fourd.recording.capture import write_calibration
from tests.calibration.rooms import Room, room_cameras
from tests.training.small import SMALL

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


def write_masks(folder: Path) -> None:
    """Masks of a ball in front of the room's corner."""
    for name, camera in zip(NAMES, room_cameras(len(NAMES), 240, 180), strict=True):
        pixels, depth = camera.project(np.array([[0.9, 0.9, 0.8]]))
        mask = np.zeros((camera.height, camera.width), np.uint8)
        centre = (round(float(pixels[0, 0])), round(float(pixels[0, 1])))
        cv2.circle(mask, centre, round(0.3 * camera.intrinsics[0, 0] / depth[0]), 255, -1)
        (folder / "masks" / name).mkdir(parents=True)
        write_picture(folder / "masks" / name / "000000.png", mask)


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


@pytest.mark.parametrize(("gains", "refine"), [(GAINS, False), (GAINS, True), ((1.0, 1.0, 1.0, 1.0), False)])
def test_runs_correct_colours_that_differ(tmp_path: Path, gains: tuple[float, ...], refine: bool) -> None:
    """Catches measured colours that a later stage removes from the run, and held-out cameras without their map."""
    capture = write_room(tmp_path / "room", gains)
    write_masks(capture)
    config = replace(SMALL, test_views=("02",), refine=RefineConfig(poses=refine))
    with create_run(capture, tmp_path / "run", config) as run:
        assert run.config.train.refine.colours == (gains == GAINS)
        refinement = run.new_refinement()
    if gains == GAINS:
        assert refinement is not None
        maps = refinement.rig().colours
        assert maps is not None
        grey = (maps[:, 0, 0] * 0.5 + maps[:, 0, 3]).numpy()
        assert np.allclose(grey / grey[1], np.array(gains) / gains[1], atol=0.03)
