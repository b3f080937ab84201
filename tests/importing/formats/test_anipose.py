"""Anipose and Pose2Sim: TOML of world-to-camera poses, in millimetres or metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fourd.recording.importing.formats.anipose import looks_like, read
from tests.importing.formats.sources import (
    BARREL,
    assert_damage_is_reported,
    assert_refused,
    assert_same_view,
    detect_format,
    edit,
    file_names,
    uneven_cameras,
    write_video,
)

NAMES = ("camA", "camB", "camC")
METADATA = "[metadata]\nadjusted = true\nerror = 0.75\n"


def calibration_toml(scale: float) -> str:
    """The cameras as Anipose and Pose2Sim write them. Pixel coordinates have their origin at the centre of the first
    pixel."""
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
    (tmp_path / "calibration.toml").write_text(calibration_toml(1000))
    for name in NAMES:
        write_video(tmp_path / "videos-raw" / f"{name}.mp4")
    return tmp_path


@pytest.mark.parametrize(("scale", "note"), [(1000, "to be millimetres"), (1, "to be metres")])
def test_cameras_project_as_the_originals(source: Path, scale: float, note: str, rng: np.random.Generator) -> None:
    """Catches a missing half-pixel shift of the principal point, and millimetres that are read as metres."""
    (source / "calibration.toml").write_text(calibration_toml(scale))
    assert detect_format(source) == detect_format(source / "calibration.toml") == "anipose"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == list(NAMES)
    for camera, original in zip(imported.cameras, uneven_cameras(3, BARREL), strict=True):
        assert_same_view(camera.calibration, original, rng)
        assert file_names(camera.frames) == [f"{camera.name}.mp4"]
    assert note in imported.notes[0]
    assert "metadata of the calibration: adjusted True, error 0.75" in imported.notes


def test_a_long_table_before_the_cameras(source: Path) -> None:
    """Catches a calibration that is not recognised, because FreeMoCap's long table of metadata comes first."""
    text = calibration_toml(1)
    path = "C:/Users/name/freemocap_data/" * 200
    head = f'[metadata]\nadjusted = false\npath_to_recorded_videos = "{path}"\n'
    (source / "calibration.toml").write_text(head + text[: text.index("[metadata]")])
    assert detect_format(source) == "anipose"
    assert len(read(source).cameras) == 3


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("[0.1]", [0.1, 0, 0, 0, 0]),
        ("[0.1, 0.2, 0.0]", [0.1, 0.2, 0, 0, 0]),
        ("[[0.1, 0.2, 0.3, 0.4]]", [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_shapes_of_distortions(source: Path, written: str, expected: list[float]) -> None:
    """Catches short lists and matrices of one row, which are refused although their meaning is clear."""
    edit(source / "calibration.toml", f"distortions = {BARREL.tolist()}", f"distortions = {written}")
    calibration = read(source).cameras[0].calibration
    assert calibration is not None
    assert calibration.distortion is not None
    assert calibration.distortion.tolist() == expected


def test_unit_of_a_single_camera_is_unknown(source: Path) -> None:
    text = calibration_toml(1000)
    (source / "calibration.toml").write_text(text[: text.index("[cam_1]")])
    for name in NAMES[1:]:
        (source / "videos-raw" / f"{name}.mp4").unlink()
    assert read(source).notes[0] == "lengths are kept: one camera is not enough to estimate the unit"


def test_other_toml_files_are_ignored(source: Path) -> None:
    (source / "calibration.toml").unlink()
    assert not looks_like(source)
    assert detect_format(source) == "videos"
    assert_refused(read, source, r"expected one TOML with the cameras' calibration, got none; name the file itself")


def test_two_calibrations_are_refused(source: Path) -> None:
    (source / "older.toml").write_text(calibration_toml(1))
    assert_refused(read, source, r"expected one TOML .*, got calibration.toml and older.toml; name the file itself")
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
        ("camB", "camA", r"\[cam_1\]: expected a unique camera name, got 'camA'; rename one"),
        ('name = "camA"\n', "", r"\[cam_0\]: expected name, size, .*, got no name; calibrate again"),
        ("size = [ 24.0, 16,]", "size = [24]", r"\[cam_0\]: size: expected 2 numbers, got 1"),
        ("size = [ 24.0, 16,]", "size = [0, 16]", r"\[cam_0\]: size: expected width and height in pixels, got 0 x 16"),
        ("translation = [", "translation = [nan, ", r"\[cam_0\]: translation: expected 3 numbers, got 4"),
        ("matrix = [[26.0", "matrix = [[nan", r"\[cam_0\]: matrix: expected finite numbers, got \[nan"),
        ("matrix = [[26.0", "matrix = [[-26.0", r"\[cam_0\]: intrinsics: expected positive focal lengths"),
        (
            "[0.0, 0.0, 1.0]]",
            "[0.0, 0.0, 2.0]]",
            r"\[cam_0\]: expected intrinsics with last row 0 0 1, got last row \[0.0, 0.0, 2.0\]",
        ),
        (
            f"distortions = {BARREL.tolist()}",
            "distortions = [0.1, 0.2, 0.3]",
            r"\[cam_0\]: distortions: expected 4 or 5 numbers, got \[0.1, 0.2, 0.3\], in which the third one may",
        ),
        ("distortions = [-0.25,", "distortions = [0, 0,", r"\[cam_0\]: distortion: expected 4, 5, 8, 12 or 14"),
        (
            "distortions = [-0.25,",
            "distortions = [[1, 2],",
            r"\[cam_0\]: distortions: expected some numbers, got somet",
        ),
    ],
)
def test_invalid_values_are_reported(source: Path, old: str, new: str, message: str) -> None:
    edit(source / "calibration.toml", old, new)
    assert_refused(read, source, message)


def test_damaged_files_are_reported(source: Path, rng: np.random.Generator) -> None:
    assert_damage_is_reported(read, source, source / "calibration.toml", rng)
