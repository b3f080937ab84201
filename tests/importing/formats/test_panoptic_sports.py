"""PanopticSports: JSON files with intrinsics, world-to-camera poses and image paths for every frame."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.recording.importing.formats.panoptic_sports import read
from tests.importing.formats.sources import (
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

TRAIN, TEST = (1, 2, 12), (0, 10)
NUMBERS = sorted((*TRAIN, *TEST))
FRAMES = 3
FILES = [f"{frame:06d}" for frame in range(FRAMES)]


def write_meta(path: Path, numbers: tuple[int, ...]) -> None:
    views = [uneven_cameras(5)[NUMBERS.index(number)] for number in numbers]
    poses = [np.vstack([np.c_[view.rotation, view.translation], [0, 0, 0, 1]]).tolist() for view in views]
    content = {
        "w": WIDTH,
        "h": HEIGHT,
        "k": [[view.intrinsics.tolist() for view in views]] * FRAMES,
        "w2c": [poses] * FRAMES,
        "fn": [[f"{number}/{file}.jpg" for number in numbers] for file in FILES],
        "cam_id": [list(numbers)] * FRAMES,
    }
    path.write_text(json.dumps(content))


def change(path: Path, edit: Callable[[dict[str, Any]], object]) -> None:
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))


@pytest.fixture
def source(tmp_path: Path) -> Path:
    write_meta(tmp_path / "train_meta.json", TRAIN)
    write_meta(tmp_path / "test_meta.json", TEST)
    for number in NUMBERS:
        write_pictures(tmp_path / "ims" / str(number), [f"{file}.jpg" for file in FILES])
    for number in TRAIN:
        write_pictures(tmp_path / "seg" / str(number), [f"{file}.png" for file in FILES])
    return tmp_path


def test_cameras_project_as_the_originals(source: Path, rng: np.random.Generator) -> None:
    """Catches inverted poses, images of another camera, and masks that are expected of held-out cameras."""
    assert detect_format(source) == "panoptic-sports"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == ["00", "01", "02", "10", "12"]
    assert imported.test_views == ("00", "10")
    for camera, number, original in zip(imported.cameras, NUMBERS, uneven_cameras(5), strict=True):
        assert_same_view(camera.calibration, original, rng)
        assert file_names(camera.frames) == [f"{file}.jpg" for file in FILES]
        assert all(path.parent.name == str(number) for path in camera.frames.paths)
        assert camera.frames.names == tuple(FILES)
        assert file_names(camera.masks) == [f"{f}.png" for f in FILES] if number in TRAIN else camera.masks is None
    assert any("some cameras have no mattes: 00, 10" in note for note in imported.notes)


def test_test_file_is_optional(source: Path) -> None:
    """Catches an import that fails, or invents a split, without test_meta.json."""
    (source / "test_meta.json").unlink()
    imported = read(source)
    assert (len(imported.cameras), imported.test_views) == (3, ())


def test_cameras_in_both_files_are_trained(source: Path) -> None:
    """Catches training cameras that are held out because test_meta.json also lists them."""
    write_meta(source / "test_meta.json", (1, 10))
    assert read(source).test_views == ("10",)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda data: data.pop("w2c"), r"train_meta.json: expected the keys .*, got no w2c; copy it again"),
        (lambda data: data["k"].pop(), r"expected lists with the same number of frames, got 2 of k, 3 of w2c"),
        (lambda data: data["fn"][1].pop(), r"frame 1: expected the same number of values for each key, got .*2 of fn"),
        (lambda data: data["k"][2][0].pop(), r"camera '01': frame 2: k: expected 3 x 3 numbers, got 2 x 3"),
        (
            lambda data: data["w2c"][0][1][0].__setitem__(0, float("nan")),
            r"camera '02': .*w2c: expected finite numbers",
        ),
        (lambda data: data["w2c"][0][1][3].__setitem__(0, 1), r"camera '02': .*expected a last row of 0 0 0 1"),
        (lambda data: data["w2c"][1][1][0].__setitem__(3, 9), r"camera '02': frame 1: expected a static .* same w2c"),
        (lambda data: data["k"][1][1][0].__setitem__(0, 99), r"camera '02': frame 1: expected a static .* same k "),
        (
            lambda data: data["fn"][0].__setitem__(0, "../a.jpg"),
            r"camera '01': frame 0: fn: expected a path within ims/",
        ),
        (
            lambda data: data["fn"][0].__setitem__(0, "/a/b.jpg"),
            r"camera '01': frame 0: fn: expected a path within ims/",
        ),
        (lambda data: data["fn"][0].__setitem__(0, 7), r"camera '01': frame 0: fn: expected an image's path"),
        (lambda data: data["cam_id"][0].__setitem__(0, 2), r"camera '02': frame 0: expected the camera once"),
        (
            lambda data: data["cam_id"][0].__setitem__(0, -2),
            r"frame 0: cam_id: expected camera numbers from 0, got '-2'",
        ),
        (lambda data: data.__setitem__("w", 0), r"expected w and h in pixels, got 0 x 16"),
    ],
)
def test_invalid_values_are_reported(source: Path, edit: Callable[[dict[str, Any]], object], message: str) -> None:
    """Catches values that are used, or fail without the file, the camera and the frame, although they are invalid."""
    # Lists that frames share in ``write_meta`` are separate lists in the parsed JSON.
    change(source / "train_meta.json", edit)
    assert_refused(read, source, message)


def test_missing_files_are_reported(source: Path) -> None:
    """Catches images and masks that are paired with the wrong frames because a file is missing."""
    mask = source / "seg" / "2" / "000001.png"
    content = mask.read_bytes()
    mask.unlink()
    assert_refused(
        read, source, r"seg/2/000001.png: expected a mask for each image of the camera, .*1 of 3 are missing"
    )
    mask.write_bytes(content)
    (source / "ims" / "2" / "000001.jpg").unlink()
    assert_refused(read, source, r"ims/2/000001.jpg: expected an image of camera '02', got no such file; restore it")


def test_mirrored_camera_to_world_poses_are_named(source: Path) -> None:
    """Catches mirrored poses that are used, and mirrored camera-to-world poses whose direction is not mentioned."""

    def mirror(data: dict[str, Any]) -> None:
        # The world is mirrored and its origin is away from the subject.
        world = np.diag([1.0, 1.0, -1.0, 1.0])
        world[:3, 3] = 2, 1, 0.5
        data["w2c"] = [[(world @ np.linalg.inv(pose)).tolist() for pose in poses] for poses in data["w2c"]]

    change(source / "train_meta.json", mirror)
    change(source / "test_meta.json", mirror)
    assert_refused(
        read, source, r"camera '01': w2c: .* got a reflection \(determinant -1, 5 of 5 .*as if camera-to-world"
    )


def test_damaged_files_are_reported(source: Path, rng: np.random.Generator) -> None:
    assert_damage_is_reported(read, source, source / "train_meta.json", rng)
