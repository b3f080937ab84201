"""EasyMocap: handwritten YAML in the style of EasyMocap's own tools, with images or videos, and optional mattes."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.recording.capture import read_calibration
from fourd.recording.importing.formats.easymocap import read
from tests.importing.formats.sources import (
    BARREL,
    HEIGHT,
    WIDTH,
    assert_damage_is_reported,
    assert_refused,
    assert_same_view,
    detect_format,
    edit,
    file_names,
    uneven_cameras,
    write_pictures,
    write_video,
)

NAMES = ("01", "02", "10")


def opencv_matrix(key: str, values: np.ndarray) -> str:
    values = np.atleast_2d(values)
    listed = ", ".join(repr(float(value)) for value in values.ravel())
    rows, columns = values.shape
    return f"{key}: !!opencv-matrix\n  rows: {rows}\n  cols: {columns}\n  dt: d\n  data: [{listed}]\n"


def write_yaml(folder: Path, distortion_key: str = "D") -> None:
    names = "%YAML:1.0\n---\nnames:\n" + "".join(f'  - "{name}"\n' for name in NAMES)
    intri, extri = names, names
    for name, camera in zip(NAMES, uneven_cameras(3), strict=True):
        intri += opencv_matrix(f"K_{name}", camera.intrinsics) + opencv_matrix(f"{distortion_key}_{name}", BARREL)
        extri += opencv_matrix(f"R_{name}", np.asarray(cv2.Rodrigues(camera.rotation)[0]))
        extri += opencv_matrix(f"Rot_{name}", camera.rotation) + opencv_matrix(
            f"T_{name}", camera.translation.reshape(3, 1)
        )
    (folder / "intri.yml").write_text(intri)
    (folder / "extri.yml").write_text(extri)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    write_yaml(tmp_path)
    for name in NAMES:
        write_pictures(tmp_path / "images" / name, ["2.jpg", "10.jpg", "1.jpg"])
        write_pictures(tmp_path / "masks" / name, ["000001.png", "000002.png", "000010.png"])
    return tmp_path


@pytest.mark.parametrize("key", ["D", "dist"])
def test_pictures_and_mattes(source: Path, key: str, rng: np.random.Generator) -> None:
    """Catches frames in the wrong order, and lens distortion that is ignored under EasyMocap's own key ``dist_CAM``."""
    write_yaml(source, key)
    assert detect_format(source) == "easymocap"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == list(NAMES)
    for camera, original in zip(imported.cameras, uneven_cameras(3, BARREL), strict=True):
        assert_same_view(camera.calibration, original, rng)
        assert file_names(camera.frames) == ["1.jpg", "2.jpg", "10.jpg"]
        assert file_names(camera.masks) == ["000001.png", "000002.png", "000010.png"]


def test_videos_give_their_own_size(source: Path) -> None:
    shutil.rmtree(source / "images")
    shutil.rmtree(source / "masks")
    for name in NAMES:
        write_video(source / "videos" / f"{name}.mp4")
    cameras = read(source).cameras
    assert [file_names(camera.frames) for camera in cameras] == [[f"{name}.mp4"] for name in NAMES]
    assert all(camera.masks is None and camera.calibration is not None for camera in cameras)
    assert {(camera.calibration.width, camera.calibration.height) for camera in cameras if camera.calibration} == {
        (WIDTH, HEIGHT)
    }
    (source / "videos" / "02.mp4").write_bytes(b"no video")
    assert_refused(read, source, r"02.mp4: expected a whole video, got '.*'; copy it again")


def test_missing_parts_are_noted(source: Path) -> None:
    shutil.rmtree(source / "masks" / "02")
    shutil.rmtree(source / "images" / "10")
    shutil.copytree(source / "images" / "01", source / "images" / "77")
    notes = read(source).notes
    assert "cameras without images, not imported: 10" in notes
    assert "without calibration: 77" in notes
    assert "some cameras have no mattes: 02, 77" in notes


@pytest.mark.parametrize("file", ["intri.yml", "extri.yml"])
@pytest.mark.parametrize("has_images", [True, False])
def test_cameras_of_one_file_are_left_out(source: Path, file: str, has_images: bool, rng: np.random.Generator) -> None:
    """Catches "Rot_10: expected a matrix" for a camera without a pose, which stops the import of all other cameras."""
    lines = (source / file).read_text()
    start = lines.index("K_10" if file == "intri.yml" else "R_10")
    (source / file).write_text(lines[:start].replace('  - "10"\n', ""))
    if not has_images:
        shutil.rmtree(source / "images" / "10")
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == ["01", "02"]
    for camera, original in zip(imported.cameras, uneven_cameras(3, BARREL)[:2], strict=True):
        assert_same_view(camera.calibration, original, rng)
    lacks, other = ("intrinsics", "extri.yml") if file == "intri.yml" else ("pose", "intri.yml")
    assert f"cameras without {lacks}, because only {other} has them, not used: 10" in imported.notes


def test_invalid_values_are_reported(source: Path) -> None:
    (source / "masks" / "02" / "000002.png").unlink()
    assert_refused(read, source, r"masks/02: expected a matte for each image, got none for 2.jpg; restore the matte")
    edit(source / "intri.yml", '"02"', '"01"')
    assert_refused(read, source, r"intri.yml: names: expected each camera once")
    edit(source / "intri.yml", "%YAML:1.0", "[")
    assert_refused(read, source, r"intri.yml: expected OpenCV FileStorage YAML")


def test_invalid_numbers_are_reported(source: Path) -> None:
    edit(source / "extri.yml", "data: [", "data: [.Nan, ")
    edit(source / "extri.yml", "rows: 3\n  cols: 1", "rows: 4\n  cols: 1")
    assert_refused(read, source, r"extri.yml: ")
    write_yaml(source, "dist")
    edit(source / "intri.yml", "cols: 5\n  dt: d\n  data: [-0.25", "cols: 5\n  dt: d\n  data: [.Nan")
    assert_refused(read, source, r"intri.yml: dist_01: expected finite numbers, got \[nan")


def test_damaged_files_are_reported(source: Path, rng: np.random.Generator) -> None:
    assert_damage_is_reported(read, source, source / "extri.yml", rng, flips=False)


def test_truncated_calibrations_are_reported(source: Path) -> None:
    """Catches an exception of OpenCV, which reads a file that is truncated within its first key as a string."""
    for name in ("intri.yml", "extri.yml"):
        whole = (source / name).read_bytes()
        for size in range(0, len(whole), 1 if len(whole) < 600 else 3):
            (source / name).write_bytes(whole[:size])
            with contextlib.suppress(UserError):
                read_calibration(source)
        for size in range(40):
            (source / name).write_bytes(whole[:size])
            with pytest.raises(UserError, match=name):
                read_calibration(source)
        (source / name).write_bytes(whole)


def test_missing_pictures_are_reported(source: Path) -> None:
    shutil.rmtree(source / "images")
    assert_refused(read, source, r"expected a video or a folder of images for each camera")
