"""Anipose and Pose2Sim: TOML of world-to-camera poses, in the board's units or in metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fourd.importing.formats.anipose import looks_like, read
from tests.importing.formats.sources import (
    BARREL,
    assert_damage_is_told,
    assert_same_view,
    assert_told,
    detected,
    edit,
    file_names,
    uneven_cameras,
    write_video,
)

NAMES = ("camA", "camB", "camC")
METADATA = "[metadata]\nadjusted = true\nerror = 0.75\n"


def toml(scale: float) -> str:
    """The cameras as both write them; OpenCV's matrix has the first pixel's centre at 0."""
    text = ""
    for index, (name, camera) in enumerate(zip(NAMES, uneven_cameras(3, BARREL), strict=True)):
        matrix = camera.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
        text += f'[cam_{index}]\nname = "{name}"\nsize = [ {camera.width}.0, {camera.height},]\n'
        text += f"matrix = {matrix.tolist()}\ndistortions = {BARREL.tolist()}\n"
        text += f"rotation = {Rotation.from_matrix(camera.rotation).as_rotvec().tolist()}\n"
        text += f"translation = {(scale * camera.translation).tolist()}\nfisheye = false\n\n"
    return text + METADATA


@pytest.fixture
def source(tmp_path: Path) -> Path:
    (tmp_path / "Config.toml").write_text('[project]\nframe_rate = 60\n[calibration]\nsize = 3\nmatrix = "no"\n')
    (tmp_path / "calibration.toml").write_text(toml(1000))
    for name in NAMES:
        write_video(tmp_path / "videos-raw" / f"{name}.mp4")
    return tmp_path


@pytest.mark.parametrize(("scale", "note"), [(1000, "millimetres -> metres"), (1, "taken for metres")])
def test_cameras_see_what_they_saw(source: Path, scale: float, note: str, rng: np.random.Generator) -> None:
    """Catches the half pixel forgotten, and millimetres taken for metres."""
    (source / "calibration.toml").write_text(toml(scale))
    assert detected(source) == detected(source / "calibration.toml") == "anipose"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == list(NAMES)
    for camera, original in zip(imported.cameras, uneven_cameras(3, BARREL), strict=True):
        assert_same_view(camera.lens, original, rng)
        assert file_names(camera.frames) == [f"{camera.name}.mp4"]
    assert note in imported.notes[0]
    assert "the file says of the calibration: adjusted True, error 0.75" in imported.notes


def test_one_camera_does_not_tell_its_unit(source: Path) -> None:
    text = toml(1000)
    (source / "calibration.toml").write_text(text[: text.index("[cam_1]")])
    for name in NAMES[1:]:
        (source / "videos-raw" / f"{name}.mp4").unlink()
    assert read(source).notes[0] == "lengths kept: one camera does not tell its unit"


def test_other_toml_is_none_of_ours(source: Path) -> None:
    (source / "calibration.toml").unlink()
    assert not looks_like(source)
    assert detected(source) == "videos"
    assert_told(read, source, r"expected one TOML with the cameras' calibration, got none; name the file itself")


def test_two_calibrations_are_told(source: Path) -> None:
    (source / "older.toml").write_text(toml(1))
    assert_told(read, source, r"expected one TOML .*, got calibration.toml and older.toml; name the file itself")
    (source / "camA.mp4").write_bytes((source / "videos-raw" / "camA.mp4").read_bytes())
    assert len(read(source / "older.toml").cameras) == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("size = [", "size = [[", r"calibration.toml: expected TOML, got '.*'; calibrate again"),
        (
            "fisheye = false",
            "fisheye = true",
            r"\[cam_0\]: expected a lens without fisheye, got fisheye = true; undist",
        ),
        ("camB", "camA", r"\[cam_1\]: expected each camera's own name, got 'camA'; rename one"),
        ('name = "camA"\n', "", r"\[cam_0\]: expected name, size, .*, got no name; calibrate again"),
        ("size = [ 24.0, 16,]", "size = [24]", r"\[cam_0\]: size: expected 2 numbers, got 1"),
        ("size = [ 24.0, 16,]", "size = [0, 16]", r"\[cam_0\]: size: expected width and height in pixels, got 0 x 16"),
        ("translation = [", "translation = [nan, ", r"\[cam_0\]: translation: expected 3 numbers, got 4"),
        ("matrix = [[26.0", "matrix = [[nan", r"\[cam_0\]: matrix: expected finite numbers, got \[nan"),
        ("matrix = [[26.0", "matrix = [[-26.0", r"\[cam_0\]: intrinsics: expected positive focal lengths"),
        ("[0.0, 0.0, 1.0]]", "[0.0, 0.0, 2.0]]", r"\[cam_0\]: expected a last row of 0 0 1, got \[0.0, 0.0, 2.0\]"),
        ("distortions = [-0.25,", "distortions = [0, 0,", r"\[cam_0\]: distortion: expected 4, 5, 8, 12 or 14"),
        (
            "distortions = [-0.25,",
            "distortions = [[1, 2],",
            r"\[cam_0\]: distortions: expected some numbers, got somet",
        ),
    ],
)
def test_faults_are_told(source: Path, old: str, new: str, message: str) -> None:
    edit(source / "calibration.toml", old, new)
    assert_told(read, source, message)


def test_damage_is_told(source: Path, rng: np.random.Generator) -> None:
    assert_damage_is_told(read, source, source / "calibration.toml", rng)
