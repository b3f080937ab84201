"""Neural 3D Video: LLFF's poses_bounds.npy, made as LLFF makes it from COLMAP's poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.cameras import Camera
from fourd.importing.formats.neural3dv import read
from tests.importing.formats.sources import (
    assert_damage_is_told,
    assert_same_view,
    assert_told,
    detected,
    file_names,
    uneven_cameras,
    write_video,
)

NAMES = ("cam00", "cam02", "cam10")


def originals() -> list[Camera]:
    """Cameras of the kind that the format can say: square pixels, the centre in the middle."""
    return [
        replace(
            camera, intrinsics=np.array([[30.0 + i, 0, camera.width / 2], [0, 30.0 + i, camera.height / 2], [0, 0, 1]])
        )
        for i, camera in enumerate(uneven_cameras(3))
    ]


def rows() -> np.ndarray:
    """Each camera's axes as points that it sees: one below its centre, one to the right, one behind."""
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


def test_cameras_see_what_they_saw(source: Path, rng: np.random.Generator) -> None:
    """Catches LLFF's axes turned wrongly, or rows that go to other videos."""
    assert detected(source) == "neural3dv"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == list(NAMES)
    for camera, original in zip(imported.cameras, originals(), strict=True):
        assert_same_view(camera.lens, original, rng)
        assert file_names(camera.frames) == [f"{camera.name}.mp4"]


def _saved(array: object) -> object:
    return lambda path: np.save(path, np.asarray(array))


def _edited(column: int, value: float) -> object:
    array = rows()
    array[1, column] = value
    return _saved(array)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_saved(rows()[:2]), r"poses_bounds.npy: expected 3 rows, one for each video \(cam00, cam02, cam10\), got 2"),
        (_saved(rows()[:, :15]), r"poses_bounds.npy: expected some x 17 numbers, got 3 x 15"),
        (_saved(np.array([{}], object)), r"poses_bounds.npy: expected an array that NumPy wrote, got '.*'; copy it"),
        (_saved(np.array(["a"])), r"poses_bounds.npy: expected real numbers, got <U1"),
        (_edited(3, np.nan), r"poses_bounds.npy: expected finite numbers, got"),
        (_edited(0, 9.0), r"poses_bounds.npy: row 1: rotation: expected an orthonormal matrix"),
        (_edited(4, 0.0), r"poses_bounds.npy: row 1: expected height and width in pixels, got 0 and 24"),
        (lambda path: path.write_text("no array"), r"poses_bounds.npy: expected an array that NumPy wrote, got"),
        (lambda path: np.savez(path.open("wb"), rows()), r"poses_bounds.npy: expected an array .*an archive of arrays"),
    ],
)
def test_faults_are_told(source: Path, spoil: object, message: str) -> None:
    assert callable(spoil)
    spoil(source / "poses_bounds.npy")
    assert_told(read, source, message)


def test_damage_is_told(source: Path, rng: np.random.Generator) -> None:
    assert_damage_is_told(read, source, source / "poses_bounds.npy", rng)
