"""ActorsHQ: a CSV of camera-to-world rotation vectors, and intrinsics relative to the image's size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fourd.recording.importing.formats.actorshq import read
from tests.importing.formats.sources import (
    assert_damage_is_reported,
    assert_refused,
    assert_same_view,
    detect_format,
    edit,
    file_names,
    uneven_cameras,
    write_pictures,
)

NAMES = ("Cam001", "Cam002", "Cam003")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    lines = ["name,w,h,rx,ry,rz,tx,ty,tz,fx,fy,px,py"]
    for name, camera in zip(NAMES, uneven_cameras(3), strict=True):
        width, height = camera.width, camera.height
        to_world = Rotation.from_matrix(camera.rotation).inv().as_rotvec()
        relative = camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]] / [width, height, width, height]
        values = [float(value) for value in (*to_world, *camera.centre, *relative)]
        lines.append(",".join([name, str(width), str(height), *map(repr, values)]))
        write_pictures(tmp_path / "rgbs" / name, [f"{name}_rgb{number:06d}.jpg" for number in (0, 9, 10)])
        write_pictures(tmp_path / "masks" / name, [f"{name}_mask{number:06d}.png" for number in (0, 9, 10)])
    (tmp_path / "calibration.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_cameras_project_as_the_originals(source: Path, rng: np.random.Generator) -> None:
    """Catches poses that are read as world-to-camera, and intrinsics that are scaled by the wrong image side."""
    assert detect_format(source) == "actorshq"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == list(NAMES)
    for camera, original in zip(imported.cameras, uneven_cameras(3), strict=True):
        assert_same_view(camera.calibration, original, rng)
        assert file_names(camera.frames) == [f"{camera.name}_rgb{number:06d}.jpg" for number in (0, 9, 10)]
        assert file_names(camera.masks) == [f"{camera.name}_mask{number:06d}.png" for number in (0, 9, 10)]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rz,tx", "rz,qx", r"calibration.csv: expected rows with name,w,.*, got no tx; copy the file again"),
        ("Cam002", "Cam001", r"calibration.csv: line 3: expected a unique camera name, got 'Cam001'"),
        ("Cam001,24,16", "Cam001,24,no", r"camera 'Cam001': h: expected 1 numbers, got something else"),
        ("Cam001,24,16", "Cam001,24,nan", r"camera 'Cam001': h: expected finite numbers, got \[nan\]"),
        ("Cam001,24,16", "Cam001,24,0", r"camera 'Cam001': expected w and h in pixels, got 24 x 0"),
        ("name,w,h", '"name,w,h', r"calibration.csv: expected ActorsHQ's CSV, got '.*'; copy it again"),
    ],
)
def test_invalid_values_are_reported(source: Path, old: str, new: str, message: str) -> None:
    edit(source / "calibration.csv", old, new)
    assert_refused(read, source, message)


def test_missing_mattes_are_reported(source: Path) -> None:
    (source / "masks" / "Cam002" / "Cam002_mask000009.png").unlink()
    assert_refused(read, source, r"masks/Cam002: expected a matte for each image, got none for Cam002_rgb000009.jpg")


def test_empty_files_are_reported(source: Path) -> None:
    (source / "calibration.csv").write_text("")
    assert_refused(read, source, r"calibration.csv: expected rows with name,w,")


def test_damaged_files_are_reported(source: Path, rng: np.random.Generator) -> None:
    assert_damage_is_reported(read, source, source / "calibration.csv", rng)
