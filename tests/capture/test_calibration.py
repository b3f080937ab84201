"""Tests of the calibration files: every camera name that fourd accepts is written and read back, and cameras that only
one of the two files contains are named.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fourd.base.errors import UserError
from fourd.recording.capture import open_capture
from fourd.recording.capture.calibration import (
    camera_name_problem,
    check_calibration,
    read_calibration,
    read_intrinsics,
    require_calibration,
    write_calibration,
)
from fourd.recording.capture.check import check_capture
from tests.captures import ring_cameras

ORDINARY = (
    "cam.1",
    "IMG 0001 (1)",
    "左",
    "00",
    "1e5",
    "true",
    "null",
    "~",
    'a"b',
    "it's",
    "C#1",
    "a: b",
    "a, b",
    "[x]",
)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.one_of(st.sampled_from(ORDINARY), st.text(max_size=30), st.text("%3A:é .#-", max_size=6)).filter(
            lambda name: camera_name_problem(name) is None
        ),
        min_size=1,
        max_size=6,
        unique=True,
    ),
    st.integers(0, 1 << 32),
)
def test_names_and_numbers_are_read_back(names: list[str], seed: int) -> None:
    """Catches a traceback of cv2.FileStorage for a name with a dot, after the whole calibration, and names of which
    one reads the values of another."""
    rng = np.random.default_rng(seed)
    cameras = [
        replace(
            camera,
            intrinsics=camera.intrinsics * [[rng.uniform(0.5, 2)], [rng.uniform(0.5, 2)], [1]],
            translation=rng.normal(size=3) * 10.0 ** rng.integers(-8, 8),
        )
        for camera in ring_cameras(len(names), 32)
    ]
    with tempfile.TemporaryDirectory() as folder:
        write_calibration(folder, names, cameras)
        read = read_calibration(folder)
        lenses = read_intrinsics(folder)
        storage = cv2.FileStorage(str(Path(folder) / "intri.yml"), cv2.FILE_STORAGE_READ)
        listed = storage.getNode("names")
        assert [listed.at(index).string() for index in range(listed.size())] == names
    assert list(read) == list(lenses) == names
    for name, camera in zip(names, cameras, strict=True):
        assert read[name].intrinsics.tobytes() == lenses[name].intrinsics.tobytes() == camera.intrinsics.tobytes()
        assert read[name].translation.tobytes() == camera.translation.tobytes()
        assert np.abs(read[name].rotation - camera.rotation).max() < 1e-12
        assert (read[name].width, read[name].height) == (camera.width, camera.height)


@pytest.mark.parametrize("unit", [None, 1.0, 0.001, 1 / 3])
def test_the_unit_is_read_back(unit: float | None, tmp_path: Path) -> None:
    """Catches a unit that is rounded, and a key that OpenCV, and thus other programs, cannot read."""
    write_calibration(tmp_path, ["00"], ring_cameras(1, 32), unit)
    assert require_calibration(tmp_path).metres_per_unit == unit
    storage = cv2.FileStorage(str(tmp_path / "extri.yml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("metres_per_unit").real() == (unit or 0)


@pytest.mark.parametrize("unit", ["mm", "0", "-1", ".Nan", ".Inf"])
def test_impossible_units_are_refused(unit: str, tmp_path: Path) -> None:
    """Catches lengths of 0 m, and the name of a unit that counts as no unit."""
    write_calibration(tmp_path, ["00"], ring_cameras(1, 32))
    extri = tmp_path / "extri.yml"
    extri.write_text(extri.read_text() + f"metres_per_unit: {unit}\n")
    with pytest.raises(UserError, match=r"extri.yml: metres_per_unit: expected .* such as 1 or 0.001, got .*; correct"):
        require_calibration(tmp_path)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("", "1 to 200 bytes"),
        ("左" * 67, "1 to 200 bytes"),
        (".hidden", "no dot and no dash"),
        ("..", "no dot and no dash"),
        ("-o", "no dot and no dash"),
        ("a/b", "'/'"),
        ("a\\b", r"'\\\\'"),
        ("a\nb", r"'\\n'"),
        ("a\udcff", r"'\\udcff'"),
        ("a ", "no space at the start and at the end"),
    ],
)
def test_names_that_cannot_be_files(name: str, problem: str, tmp_path: Path) -> None:
    """Catches a name that leaves the capture's folder, is hidden, or looks like an option."""
    with pytest.raises(ValueError, match=problem):
        write_calibration(tmp_path, [name], ring_cameras(1, 32))
    assert not any(tmp_path.iterdir())


def matrix(key: str, values: np.ndarray) -> str:
    rows, columns = np.atleast_2d(values).shape
    listed = ", ".join(map(str, np.ravel(values)))
    return f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {listed} ]\n"


def lens(name: str) -> str:
    return matrix(f"K_{name}", np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]))


def pose(name: str) -> str:
    return matrix(f"Rot_{name}", np.eye(3)) + matrix(f"T_{name}", np.zeros(3))


def listing(*names: str) -> str:
    return "".join(["%YAML:1.0\n---\nnames:\n", *(f'   - "{name}"\n' for name in names)])


@pytest.mark.parametrize("listed", [("1", "2", "3"), ("1", "2")])
def test_cameras_of_one_file(listed: tuple[str, ...], tmp_path: Path) -> None:
    """Catches "Rot_3: expected a matrix" for a camera without a pose, which makes all other cameras unusable."""
    (tmp_path / "intri.yml").write_text(listing("1", "2", "3") + lens("1") + lens("2") + lens("3"))
    (tmp_path / "extri.yml").write_text(listing(*listed, "4") + pose("1") + pose("2") + pose("4"))
    report = check_calibration(tmp_path)
    assert not report.errors
    assert list(read_calibration(tmp_path)) == list(report.names) == ["1", "2"]
    assert report.notes == (
        "cameras without pose, because only intri.yml has them, not used: 3",
        "cameras without intrinsics, because only extri.yml has them, not used: 4",
    )
    (tmp_path / "extri.yml").write_text(listing("4") + pose("4"))
    with pytest.raises(UserError, match=r"intri.yml: expected cameras that are in extri.yml too, got 1, 2, 3, 4"):
        read_calibration(tmp_path)


@pytest.mark.parametrize("file", ["intri.yml", "extri.yml"])
def test_captures_with_cameras_of_one_file(file: str, ball_capture: Path, tmp_path: Path) -> None:
    """Catches a folder of EasyMocap that cannot be used in place because one camera has no pose."""
    capture = tmp_path / "capture"
    shutil.copytree(ball_capture, capture)
    calibrations = read_calibration(capture)
    names = [name for name in calibrations if name != "06"]
    whole = (capture / file).read_text()
    write_calibration(capture, names, [calibrations[name].camera(64, 64) for name in names])
    (capture / file).write_text(whole)
    assert list(open_capture(capture).names) == names
    with pytest.raises(UserError, match=r"expected camera names among .* got '06'"):
        open_capture(capture, views=["06"])
    report = check_capture(capture)
    lacks = "pose" if file == "intri.yml" else "intrinsics"
    assert not report.problems
    assert f"{capture}: cameras without {lacks}, because only {file} has them, not used: 06" in report.warnings


def test_files_that_were_written_by_hand(tmp_path: Path) -> None:
    """Catches the refusal of names without quotes, which look like numbers, of a missing header, and of a byte order
    mark."""
    text = "names:\n   - 01\n   - 2\n" + lens("01") + lens("2")
    (tmp_path / "intri.yml").write_text(text)
    (tmp_path / "extri.yml").write_text("\ufeff%YAML:1.0\r\n---\r\n" + pose("01") + pose("2"))
    assert list(read_calibration(tmp_path)) == ["01", "2"]
    vector = matrix("Rot_2", np.zeros(3)) + matrix("T_2", np.zeros(3))
    (tmp_path / "extri.yml").write_text(listing("01", "2") + pose("01") + vector)
    with pytest.raises(UserError, match=r"Rot_2: expected a rotation matrix .* rename the key to R_2"):
        read_calibration(tmp_path)
