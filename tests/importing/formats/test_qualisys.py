"""Tests of the importer for Qualisys files. Poses are in millimetres, with y up and z backwards. Focal lengths are in
1/64 pixel, and the image is a part of the sensor."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.recording.importing.formats.qualisys import read, read_cameras
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

BALANCE = Path(__file__).parents[3].parent / "shared" / "captures" / "balance" / "Calib.qca.txt"
LEFT, TOP = 5, 3
NAMES = ("11", "12", "13")


def camera_xml(serial: str, camera: Camera) -> str:
    """A camera as Qualisys writes it: the camera axes are vectors, and the image is a part of the sensor."""
    right, down, forward = camera.rotation
    axes = {"1": right, "2": -down, "3": -forward}
    rotation = " ".join(f'r{i}{j}="{axis[j - 1]!r}"' for i, axis in axes.items() for j in (1, 2, 3))
    position = " ".join(f'{axis}="{1000 * value!r}"' for axis, value in zip("xyz", camera.centre, strict=True))
    k1, k2, p1, p2, k3 = BARREL
    focal_x, focal_y = camera.intrinsics[0, 0], camera.intrinsics[1, 1]
    u, v = camera.intrinsics[0, 2] - 0.5 + LEFT, camera.intrinsics[1, 2] - 0.5 + TOP
    text = f"""<camera active="1" serial="{serial}" viewrotation="0">
      <fov_video left="{LEFT}" top="{TOP}" right="{LEFT + camera.width - 1}" bottom="{TOP + camera.height - 1}"/>
      <transform {position} {rotation}/>
      <intrinsic focalLengthU="{64 * focal_x!r}" focalLengthV="{64 * focal_y!r}" centerPointU="{64 * u!r}"
        centerPointV="{64 * v!r}" skew="0.0" radialDistortion1="{k1}" radialDistortion2="{k2}"
        radialDistortion3="{k3}" tangentalDistortion1="{p1}" tangentalDistortion2="{p2}"/></camera>"""
    return text.replace("np.float64(", "").replace(')"', '"')


@pytest.fixture
def source(tmp_path: Path) -> Path:
    text = "".join(camera_xml(name, camera) for name, camera in zip(NAMES, uneven_cameras(3, BARREL), strict=True))
    text = f"<?xml version='1.0' encoding='ASCII'?><calibration><cameras>{text}</cameras></calibration>"
    (tmp_path / "Calib.qca.txt").write_text(text)
    for name in NAMES:
        write_video(tmp_path / f"Miqus_{name}.mp4")
    return tmp_path


def test_cameras_project_as_the_originals(source: Path, rng: np.random.Generator) -> None:
    """Catches wrong camera axes, wrong units, or the wrong part of the sensor."""
    assert detect_format(source) == detect_format(source / "Calib.qca.txt") == "qualisys"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == [f"Miqus_{name}" for name in NAMES]
    for camera, original in zip(imported.cameras, uneven_cameras(3, BARREL), strict=True):
        assert_same_view(camera.calibration, original, rng)
        assert file_names(camera.frames) == [f"{camera.name}.mp4"]
    assert "millimetres" in imported.notes[0]


def test_cameras_without_video_are_noted(source: Path) -> None:
    (source / "Miqus_12.mp4").unlink()
    assert "cameras without a video, not imported: 12" in read(source).notes


def test_cameras_without_a_calibration_are_noted(source: Path, rng: np.random.Generator) -> None:
    """Catches one uncalibrated camera, often a marker camera without a video, that stops the import of all others."""
    empty = '<camera active="1" calibrated="false" serial="20" viewrotation="0"></camera>'
    edit(source / "Calib.qca.txt", "</cameras>", f"{empty}</cameras>")
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == [f"Miqus_{name}" for name in NAMES]
    assert "cameras that Qualisys has not calibrated: 20" in imported.notes
    (source / "Calib.qca.txt").write_text(f"<calibration><cameras>{empty}</cameras></calibration>")
    assert_refused(read, source, r"expected <camera> entries with a calibration, got only cameras without .* \(20\);")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<calibration>", "<calibration", r"Calib.qca.txt: expected Qualisys' XML, got '.*'; export it again"),
        ('serial="12"', 'serial="11"', r"expected a unique serial number, got '11'"),
        ('viewrotation="0"', 'viewrotation="90"', r"camera '11': expected viewrotation 0"),
        ('skew="0.0"', 'skew="no"', r"camera '11': <intrinsic skew>: expected a finite number, got 'no'"),
        ('r11="', 'r11="nan" r19="', r"camera '11': <transform r11>: expected a finite number, got 'nan'"),
        ('right="', 'right="inf" x="', r"camera '11': <fov_video right>: expected a finite number, got 'inf'"),
        ('right="', 'right="1e99" x="', r"camera '11': <fov_video>: expected a part of the sensor, got none"),
        ('r11="', 'r11="9" r19="', r"camera '11': rotation: expected an orthonormal matrix"),
    ],
)
def test_invalid_values_are_reported(source: Path, old: str, new: str, message: str) -> None:
    edit(source / "Calib.qca.txt", old, new)
    assert_refused(read, source, message)


def test_damaged_files_are_reported(source: Path, rng: np.random.Generator) -> None:
    assert_damage_is_reported(read, source, source / "Calib.qca.txt", rng)


def test_videos_of_other_names_are_refused(source: Path) -> None:
    for path in source.glob("*.mp4"):
        path.rename(path.with_name(f"{path.stem}9.mp4"))
    assert_refused(read, source, r"Calib.qca.txt: expected calibrations with the names of the cameras \(Miqus_119, ")


def test_real_calibration_agrees_with_pose2sim() -> None:
    """Catches a pose convention that fits the files that these tests write, but not real files. The expected numbers
    are from Pose2Sim's Calib_qualisys.toml.
    """
    if not BALANCE.is_file():
        pytest.skip(f"{BALANCE} is not there")
    cameras = read_cameras(BALANCE)
    assert list(cameras) == ["cam01", "cam02", "cam03", "cam04"]
    camera = cameras["cam03"]
    assert (camera.width, camera.height) == (1088, 1920)
    assert np.allclose(cv2.Rodrigues(camera.rotation)[0].ravel(), [0.81096549, -2.19721293, 1.37602778], atol=1e-7)
    assert np.allclose(camera.translation, [-0.79348039, 0.32283594, 4.35351487], atol=1e-7)
    assert np.allclose(np.diag(camera.intrinsics), [1681.598388671875, 1681.509887703125, 1], atol=1e-6)
    assert np.allclose(camera.intrinsics[:2, 2] - 0.5, [513.20837403125, 955.005126953125], atol=1e-6)


def test_reflections_are_named(source: Path) -> None:
    """Catches mirrored poses that are used."""
    path = next(source.glob("*.txt"))
    text = re.sub(r'(r1[123]=")(-?)', lambda found: found[1] + ("" if found[2] else "-"), path.read_text())
    path.write_text(text)
    assert_refused(read, source, r"camera '11': rotation: .* got a reflection \(determinant -1\)")
