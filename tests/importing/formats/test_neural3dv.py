"""Neural 3D Video: LLFF's poses_bounds.npy, as LLFF computes this file from COLMAP's poses."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.recording.importing.formats.neural3dv import read
from tests.importing.formats.sources import (
    assert_damage_is_reported,
    assert_refused,
    assert_same_view,
    detect_format,
    file_names,
    uneven_cameras,
    write_video,
)

NAMES = ("cam00", "cam02", "cam10")


def originals() -> list[Camera]:
    """Cameras that the format can represent, with square pixels and the principal point at the image centre."""
    return [
        replace(
            camera, intrinsics=np.array([[30.0 + i, 0, camera.width / 2], [0, 30.0 + i, camera.height / 2], [0, 0, 1]])
        )
        for i, camera in enumerate(uneven_cameras(3))
    ]


def rows() -> np.ndarray:
    """Rows of poses_bounds.npy. The directions down, right and backwards are computed from one point on each camera
    axis."""
    made = []
    for camera in originals():
        to_world = np.linalg.inv(np.vstack([np.c_[camera.rotation, camera.translation], [0, 0, 0, 1]]))
        columns = [(to_world @ [*axis, 1])[:3] - camera.centre for axis in ([0, 1, 0], [1, 0, 0], [0, 0, -1])]
        size = [camera.height, camera.width, camera.intrinsics[0, 0]]
        made.append(np.r_[np.stack([*columns, camera.centre, size], axis=1).ravel(), 0.5, 9.0])
    return np.array(made)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    np.save(tmp_path / "poses_bounds.npy", rows())
    for name in NAMES:
        write_video(tmp_path / f"{name}.mp4")
    return tmp_path


def test_cameras_project_as_the_originals(source: Path, rng: np.random.Generator) -> None:
    """Catches wrong camera axes, and rows that are assigned to the wrong videos."""
    assert detect_format(source) == "neural3dv"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == list(NAMES)
    for camera, original in zip(imported.cameras, originals(), strict=True):
        assert_same_view(camera.calibration, original, rng)
        assert file_names(camera.frames) == [f"{camera.name}.mp4"]


def test_reflections_are_named(source: Path) -> None:
    """Catches mirrored poses that are used."""
    mirrored = rows()
    mirrored[1, 0:15:5] *= -1
    np.save(source / "poses_bounds.npy", mirrored)
    assert_refused(read, source, r"poses_bounds.npy: row 1: rotation: .* got a reflection \(determinant -1\)")


def _save(array: object) -> object:
    return lambda path: np.save(path, np.asarray(array))


def _save_header(shape: str) -> object:
    """Return a function that writes a file with the given shape in its header. The header is a Python literal."""
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({shape})}}\n".encode()
    return lambda path: path.write_bytes(b"\x93NUMPY\2\0" + struct.pack("<I", len(text)) + text)


def _save_edited(column: int, value: float) -> object:
    array = rows()
    array[1, column] = value
    return _save(array)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_save(rows()[:2]), r"poses_bounds.npy: expected 3 rows, one for each video \(cam00, cam02, cam10\), got 2"),
        (_save(rows()[:, :15]), r"poses_bounds.npy: expected some x 17 numbers, got 3 x 15"),
        (_save(np.array([{}], object)), r"poses_bounds.npy: expected a NumPy array, got '.*'; copy it"),
        (_save(np.array(["a"])), r"poses_bounds.npy: expected real numbers, got <U1"),
        (_save_edited(3, np.nan), r"poses_bounds.npy: expected finite numbers, got"),
        (_save_edited(0, 9.0), r"poses_bounds.npy: row 1: rotation: expected an orthonormal matrix"),
        (_save_edited(4, 0.0), r"poses_bounds.npy: row 1: expected height and width in pixels, got 0 and 24"),
        (_save_header("-" * 5000 + "1, 17"), r"poses_bounds.npy: expected a NumPy array, got"),
        (_save_header("(" * 5000 + ")" * 5000 + ", 17"), r"poses_bounds.npy: expected a NumPy array, got"),
        (_save_header("1000000000000, 17"), r"poses_bounds.npy: expected a NumPy array, got"),
        (lambda path: path.write_text("no array"), r"poses_bounds.npy: expected a NumPy array, got"),
        (
            lambda path: np.savez(path.open("wb"), rows()),
            r"expected a NumPy array, got 'another format'",
        ),
    ],
)
def test_invalid_values_are_reported(source: Path, damage: object, message: str) -> None:
    assert callable(damage)
    damage(source / "poses_bounds.npy")
    assert_refused(read, source, message)


def test_damaged_files_are_reported(source: Path, rng: np.random.Generator) -> None:
    assert_damage_is_reported(read, source, source / "poses_bounds.npy", rng)
