"""transforms.json: OpenGL poses, static and with times, and paths that leave the folder."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.recording.importing.formats.transforms_json import read
from tests.importing.formats.sources import (
    BARREL,
    HEIGHT,
    WIDTH,
    assert_damage_is_reported,
    assert_refused,
    assert_same_view,
    detect_format,
    file_names,
    uneven_cameras,
    write_pictures,
)


def make_entry(camera: Camera, file: str, **more: object) -> dict[str, Any]:
    """A JSON entry. The columns of the pose are the camera's right, up and backward axes and its position in the
    world."""
    right, down, forward = camera.rotation
    matrix = np.vstack([np.stack([right, -down, -forward, camera.centre], axis=1), [0, 0, 0, 1]])
    (focal_x, _, centre_x), (_, focal_y, centre_y), _ = camera.intrinsics.tolist()
    lens = {"fl_x": focal_x, "fl_y": focal_y, "cx": centre_x, "cy": centre_y, "w": camera.width, "h": camera.height}
    return {"file_path": file, "transform_matrix": matrix.tolist(), **lens, **more}


def write(folder: Path, frames: list[dict[str, Any]], **more: object) -> Path:
    (folder / "transforms.json").write_text(json.dumps({"frames": frames, **more}))
    return folder


@pytest.fixture
def static(tmp_path: Path) -> Path:
    """Three cameras with one frame each. The lens distortion is stored once for all cameras."""
    write_pictures(tmp_path / "images", [f"cam {index}.png" for index in range(3)])
    write_pictures(tmp_path / "masks", [f"m{index}.png" for index in range(3)])
    frames = [
        make_entry(camera, f"./images/cam {index}", mask_path=f"masks/m{index}.png")
        for index, camera in enumerate(uneven_cameras(3))
    ]
    coefficients = dict(zip(("k1", "k2", "p1", "p2", "k3"), BARREL.tolist(), strict=True))
    return write(tmp_path, frames, camera_model="OPENCV", aabb_scale=4, offset=[0.5, 0.5, 0.5], **coefficients)


def write_moving(folder: Path, pattern: str) -> Path:
    """Two cameras at three times. The file does not list the times in order."""
    frames = []
    for index, camera in enumerate(uneven_cameras(2)):
        for number in (2, 0, 1):
            file = pattern.format(camera=index, frame=number)
            write_pictures(folder / Path(file).parent, [Path(file).name])
            frames.append(make_entry(camera, file, time=number / 2))
    return write(folder, frames)


def test_static_cameras(static: Path, rng: np.random.Generator) -> None:
    """Catches wrong camera axes, values for the whole file that are ignored, and images that are not found without a
    suffix."""
    assert detect_format(static) == detect_format(static / "transforms.json") == "transforms"
    imported = read(static)
    assert [camera.name for camera in imported.cameras] == ["cam_0", "cam_1", "cam_2"]
    for index, (camera, original) in enumerate(zip(imported.cameras, uneven_cameras(3, BARREL), strict=True)):
        assert_same_view(camera.calibration, original, rng)
        assert file_names(camera.frames) == [f"cam {index}.png"]
        assert file_names(camera.masks) == [f"m{index}.png"]
    assert "ignored: aabb_scale, offset" in imported.notes


@pytest.mark.parametrize("pattern", ["cam{camera}/{frame:02d}.jpg", "images/{camera}_{frame:02d}.jpg"])
def test_cameras_with_times(tmp_path: Path, pattern: str, rng: np.random.Generator) -> None:
    """Catches frames that are sorted by their position in the file instead of by their time. The images are in one
    folder per camera or in one common folder.
    """
    imported = read(write_moving(tmp_path, pattern))
    names = ["cam0", "cam1"] if pattern.startswith("cam") else ["00", "01"]
    assert [camera.name for camera in imported.cameras] == names
    for index, (camera, original) in enumerate(zip(imported.cameras, uneven_cameras(2), strict=True)):
        assert_same_view(camera.calibration, original, rng)
        files = [Path(pattern.format(camera=index, frame=number)).name for number in range(3)]
        assert file_names(camera.frames) == files
        assert camera.masks is None


def test_focal_length_from_a_field_of_view(tmp_path: Path, rng: np.random.Generator) -> None:
    camera = uneven_cameras(1)[0]
    write_pictures(tmp_path, ["a.jpg"])
    sparse = make_entry(camera, "a.jpg")
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        del sparse[key]
    write(tmp_path, [sparse], camera_angle_x=2 * math.atan(WIDTH / 2 / 30))
    expected = np.array([[30, 0, WIDTH / 2], [0, 30, HEIGHT / 2], [0, 0, 1]])
    assert_same_view(
        read(tmp_path).cameras[0].calibration, Camera(expected, camera.rotation, camera.translation, 24, 16), rng
    )


def test_equal_file_names_use_the_folders_names(tmp_path: Path) -> None:
    for index in range(2):
        write_pictures(tmp_path / "images" / f"c{index}", ["000.jpg"])
    frames = [make_entry(camera, f"images/c{index}/000.jpg") for index, camera in enumerate(uneven_cameras(2))]
    assert [camera.name for camera in read(write(tmp_path, frames)).cameras] == ["c0", "c1"]
    frames[1]["file_path"] = frames[0]["file_path"]
    assert_refused(read, write(tmp_path, frames), r"transforms.json: expected each image once, got the same")


INVALID_VALUES: list[tuple[dict[str, object], str]] = [
    (
        {"file_path": "../secret.png"},
        r"entry 1: file_path: expected a path within .*, got '../secret.png'; write a",
    ),
    ({"file_path": "/etc/secret.png"}, r"entry 1: file_path: expected a path within .*, got '/etc/secret.png'"),
    ({"file_path": "images\\..\\..\\x.png"}, r"entry 1: file_path: expected a path within "),
    ({"file_path": "C:\\x.png"}, r"entry 1: file_path: expected a path within "),
    ({"mask_path": "../x.png"}, r"entry 1: mask_path: expected a path within "),
    (
        {"file_path": "images/none"},
        r"entry 1: file_path: expected an image at .*images/none, got none; restore",
    ),
    ({"file_path": "x" * 300}, r"entry 1: file_path: expected an image at .*, got none; restore"),
    ({"file_path": 7}, r"entry 1: file_path: expected an image's path, got '7'"),
    ({"fl_x": float("nan")}, r"entry 1: fl_x: expected finite numbers, got \[nan\]"),
    ({"fl_x": "wide"}, r"entry 1: fl_x: expected 1 numbers, got something else"),
    ({"fl_x": None}, r"entry 1: expected fl_x, camera_angle_x, K, intrinsics, camera_intrinsics or .*, got none"),
    ({"w": 0}, r"entry 1: w and h: expected pixels, got 0 x 16"),
    (
        {"transform_matrix": [[1, 2], [3]]},
        r"entry 1: transform_matrix: expected 4 x 4 numbers, got something else",
    ),
    ({"transform_matrix": np.diag([2, 1, 1, 1]).tolist()}, r"entry 1: rotation: expected an orthonormal matrix"),
    (
        {"camera_model": "OPENCV_FISHEYE"},
        r"entry 1: camera_model: expected OPENCV, .*, got OPENCV_FISHEYE; undistort",
    ),
    ({"is_fisheye": True}, r"entry 1: camera_model: expected OPENCV, .*, got a fisheye; undistort"),
    ({"time": 0.5}, r"transforms.json: expected a time in all 3 entries or in none, got a time in 1; add the missing"),
]


@pytest.mark.parametrize(("values", "message"), INVALID_VALUES)
def test_invalid_values_are_reported(static: Path, values: dict[str, object], message: str) -> None:
    data = json.loads((static / "transforms.json").read_text())
    data["frames"][1].update(values)
    (static / "transforms.json").write_text(json.dumps(data))
    assert_refused(read, static, message)


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"frames": [1]}', "[" * 100_000])
def test_other_json_is_refused(static: Path, text: str) -> None:
    (static / "transforms.json").write_text(text)
    assert_refused(read, static, r"transforms.json: expected (a list 'frames'|JSON)")


def test_frames_are_named_after_their_times(tmp_path: Path) -> None:
    """Catches a lost image whose successors are paired with the images of earlier times."""
    data = json.loads((write_moving(tmp_path, "cam{camera}/{frame:02d}.jpg") / "transforms.json").read_text())
    del data["frames"][1]
    write(tmp_path, data["frames"])
    names = {camera.name: camera.frames.names for camera in read(tmp_path).cameras}
    assert names == {"cam0": ("000001", "000002"), "cam1": ("000000", "000001", "000002")}


def test_moving_cameras_are_refused(tmp_path: Path) -> None:
    data = json.loads((write_moving(tmp_path, "cam{camera}/{frame:02d}.jpg") / "transforms.json").read_text())
    data["frames"][1]["time"] = data["frames"][0]["time"]
    write(tmp_path, data["frames"])
    assert_refused(read, tmp_path, r"expected static cameras with each time once, got 2 different times in 3 images")


def test_damaged_files_are_reported(static: Path, rng: np.random.Generator) -> None:
    assert_damage_is_reported(read, static, static / "transforms.json", rng)


@pytest.mark.parametrize("key", ["K", "intrinsics", "camera_intrinsics"])
@pytest.mark.parametrize("kind", ["3 x 3", "4 x 4", "flat"])
def test_matrices_of_intrinsics(tmp_path: Path, key: str, kind: str, rng: np.random.Generator) -> None:
    """Catches intrinsics of each frame that are ignored in favour of those of the whole file."""
    cameras = uneven_cameras(3)
    frames = []
    for index, camera in enumerate(cameras):
        write_pictures(tmp_path, [f"{index}.jpg"])
        wide = np.eye(4)
        wide[:3, :3] = camera.intrinsics
        matrix = {"3 x 3": camera.intrinsics, "4 x 4": wide, "flat": camera.intrinsics.ravel()}[kind]
        frames.append(make_entry(camera, f"{index}.jpg") | {key: matrix.tolist()})
        for name in ("fl_x", "fl_y", "cx", "cy"):
            del frames[-1][name]
    write(tmp_path, frames, fl_x=99.0, fl_y=99.0, cx=5.0, cy=5.0)
    for camera, original in zip(read(tmp_path).cameras, cameras, strict=True):
        assert_same_view(camera.calibration, original, rng)
    frames[1] |= {"fl_x": 30.0}
    write(tmp_path, frames)
    assert_refused(read, tmp_path, rf"entry 1: expected {key} and fl_x, fl_y, cx, cy to be the same, got different")
    write(tmp_path, [frames[0] | {key: [[1.1, 0, 0.5], [0, 1.1, 0.5], [0, 0, 1]]}])
    assert_refused(read, tmp_path, rf"entry 0: {key}: expected pixels, got a principal point at x = 0.5; if the values")
    write(tmp_path, [frames[0] | {key: [[1.1, 0], [0, 1.1]]}])
    assert_refused(read, tmp_path, rf"entry 0: {key}: expected 3 x 3 numbers, got 2 x 2")


def test_coefficients_that_opencv_lacks(static: Path, rng: np.random.Generator) -> None:
    """Catches coefficients that are dropped without a word, r^8 that is called a fisheye, and COLMAP's rational model
    that is refused although OpenCV has it."""
    data = json.loads((static / "transforms.json").read_text())
    write(static, data["frames"], camera_model="OPENCV", k1=0.1, k4=0.001)
    assert_refused(read, static, r"entry 0: k4: expected 0, got 0.001, a term of r\^8, which OpenCV's lens model lacks")
    write(static, data["frames"], camera_model="OPENCV", k1=0.1, k6=0.001)
    assert_refused(read, static, r"entry 0: k6: expected 0, got 0.001, which is not supported; undistort the images")
    write(static, data["frames"], camera_model="OPENCV_FISHEYE", k1=0.1)
    assert_refused(read, static, r"entry 0: camera_model: expected OPENCV.* got OPENCV_FISHEYE; undistort")
    write(static, data["frames"], is_fisheye=True)
    assert_refused(read, static, r"entry 0: camera_model: expected OPENCV.* got a fisheye; undistort")
    values = (0.1, 0.02, 0.001, 0.002, 0.003, 0.2, 0.04, 0.005)
    coefficients = dict(zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), values, strict=True))
    write(static, data["frames"], camera_model="FULL_OPENCV", **coefficients)
    for camera, original in zip(read(static).cameras, uneven_cameras(3, np.array(values)), strict=True):
        assert_same_view(camera.calibration, original, rng)


def test_names_in_other_scripts(tmp_path: Path) -> None:
    """Catches file names of which all letters are replaced, so that they are equal."""
    write_pictures(tmp_path / "images", ["左.jpg", "右.jpg"])
    left, right = uneven_cameras(2)
    write(tmp_path, [make_entry(left, "images/左.jpg"), make_entry(right, "images/右.jpg")])
    assert [camera.name for camera in read(tmp_path).cameras] == ["左", "右"]


def test_reflections_are_named(static: Path) -> None:
    """Catches mirrored poses that are used."""
    content = json.loads((static / "transforms.json").read_text())
    matrix = np.array(content["frames"][1]["transform_matrix"])
    matrix[:, 0] *= -1
    content["frames"][1]["transform_matrix"] = matrix.tolist()
    (static / "transforms.json").write_text(json.dumps(content))
    assert_refused(read, static, r"transforms.json: entry 1: rotation: .* got a reflection \(determinant -1\)")
