"""Camera paths of nerfstudio's viewer, and the poses of transforms.json."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.viewer.camera_paths.path import CameraPath
from fourd.viewer.camera_paths.reading import read_path, write_path
from fourd.viewer.camera_paths.world import World, read_world
from tests.viewer.camera_paths.exports import FOV_DEG, SCENE, SIZE, camera_to_world, cameras, viewer_export, write

Content = dict[str, Any]


def assert_same_cameras(path: CameraPath, expected: list[Camera]) -> None:
    assert len(path.samples) == len(expected)
    for sample, camera in zip(path.samples, expected, strict=True):
        found = sample.pose.camera(*SIZE)
        np.testing.assert_allclose(found.rotation, camera.rotation, atol=1e-6)
        np.testing.assert_allclose(found.centre, camera.centre, atol=1e-6)
        np.testing.assert_allclose(found.intrinsics, camera.intrinsics, atol=1e-6)


def test_the_viewers_export_is_read(tmp_path: Path) -> None:
    """Catches exchanged axes, columns for rows, radians for degrees, and times that count frames."""
    expected = cameras()
    export = viewer_export([camera_to_world(camera) for camera in expected], [0.0, 0.3, 0.6, 1.0])
    path = read_path(write(tmp_path / "a.json", export), SCENE)
    assert_same_cameras(path, expected)
    assert [sample.frame for sample in path.samples] == [0, 2, 4, 7]
    assert (path.fps, path.size, path.lens, path.has_frames) == (2.0, SIZE, "pinhole", True)
    assert not path.notes
    # The first viewer of nerfstudio stored the matrices of key frames as text.
    keys = [{"matrix": str([1.0] * 16), "fov": 50, "aspect": 1.5, "properties": [["FOV", 50], ["NAME", "Camera 0"]]}]
    old = read_path(write(tmp_path / "a.json", {**export, "keyframes": keys, "crop": {"crop_rot": []}}), SCENE)
    assert_same_cameras(old, expected)
    assert old.notes == ("crop: not used",)
    for image in export["camera_path"][:2]:
        del image["render_time"]
    assert not read_path(write(tmp_path / "a.json", export), SCENE).has_frames, "as ns-render, all or none"


def test_a_file_with_key_frames_only_is_interpolated(tmp_path: Path) -> None:
    """Catches key frames that are ignored, and transitions that belong to the wrong side of a key frame."""
    expected = cameras()
    export = viewer_export([camera_to_world(camera) for camera in expected])
    keys = [{"matrix": camera_to_world(each).ravel().tolist(), "fov": FOV_DEG, "aspect": 1.5} for each in expected]
    keys[1] |= {"override_transition_enabled": True, "override_transition_sec": 0.5}
    export |= {"keyframes": keys, "camera_path": [], "is_cycle": True, "fps": 10}
    path = read_path(write(tmp_path / "a.json", export), SCENE)
    assert len(path.samples) == 65
    at_keys = [path.samples[index] for index in (0, 5, 25, 45)]
    assert_same_cameras(CameraPath(tuple(at_keys), 1.0), expected)


@pytest.mark.parametrize("has_applied", [False, True])
def test_paths_of_nerfstudios_world_lead_through_the_capture(has_applied: bool, tmp_path: Path) -> None:
    """Catches a path beside the subject, because nerfstudio turns, moves and scales the world before its training."""
    expected = cameras()
    turn, shift, scale = Rotation.from_rotvec([0.3, -1.1, 0.4]).as_matrix(), np.array([0.5, -2.0, 1.0]), 0.25
    # In nerfstudio, poses are turned and moved, and then their positions are scaled.
    matrices = [camera_to_world(camera, turn, shift) for camera in expected]
    for matrix in matrices:
        matrix[:3, 3] *= scale
    parser = np.column_stack([turn, shift])
    files = [tmp_path / "dataparser_transforms.json", tmp_path / "transforms.json"][: 1 + has_applied]
    if has_applied:  # The capture is in the world of transforms.json, and the file relates that of COLMAP.
        applied = np.array([[1.0, 0, 0, 0.5], [0, 0, 1, 0], [0, -1, 0, 2]])
        parser = parser @ np.vstack([applied, [0, 0, 0, 1]])
        write(files[1], {"frames": [], "applied_transform": applied.tolist()})
    write(files[0], {"transform": parser.tolist(), "scale": scale})
    world = read_world(files)
    path = read_path(write(tmp_path / "a.json", viewer_export(matrices)), SCENE, world)
    assert_same_cameras(path, expected)
    write_path(tmp_path / "b.json", path, SIZE, SCENE, world)
    written = json.loads((tmp_path / "b.json").read_text())
    found = [np.reshape(image["camera_to_world"], (4, 4)) for image in written["camera_path"]]
    np.testing.assert_allclose(found, matrices, atol=1e-6)


@pytest.mark.parametrize("times", [None, [0.0, 3 / 7, 4 / 7, 1.0]])
def test_written_files_have_the_keys_of_the_viewer(times: list[float] | None, tmp_path: Path) -> None:
    """Catches a file that nerfstudio's viewer or ns-render cannot read."""
    export = viewer_export([camera_to_world(camera) for camera in cameras()], times)
    path = read_path(write(tmp_path / "a.json", export), SCENE)
    write_path(tmp_path / "b.json", path, SIZE, SCENE)
    written = json.loads((tmp_path / "b.json").read_text())
    assert set(written) == set(export)
    assert {type(value) for value in written.values()} >= {int, float, str, bool, list}
    for kind in ("keyframes", "camera_path"):
        assert set(written[kind][0]) == set(export[kind][0])
    assert len(written["keyframes"]) == 4
    for image, given in zip(written["camera_path"], export["camera_path"], strict=True):
        np.testing.assert_allclose(image["camera_to_world"], given["camera_to_world"], atol=1e-9)
        assert image.get("render_time") == pytest.approx(given.get("render_time"))
    assert (written["seconds"], written["render_width"], written["camera_type"]) == (2.0, SIZE[0], "perspective")


@pytest.mark.parametrize("has_times", [False, True])
def test_the_poses_of_transforms_json_are_a_path(has_times: bool, tmp_path: Path) -> None:
    """Catches poses that need images to be there, intrinsics of the whole file that are lost, and times that count."""
    expected = cameras()
    entries = [
        {"file_path": f"images/{i}.png", "transform_matrix": camera_to_world(each).tolist()}
        | ({"time": i / 3} if has_times else {})
        for i, each in enumerate(expected)
    ]
    focal = float(expected[0].intrinsics[0, 0])
    content = {"fl_x": focal, "fl_y": focal, "cx": 48, "cy": 32, "w": SIZE[0], "h": SIZE[1], "k1": 0.1}
    path = read_path(write(tmp_path / "transforms.json", {**content, "frames": entries}), SCENE)
    assert_same_cameras(path, expected)
    assert path.notes == ("lens distortion: not used, images are those of pinhole cameras",)
    assert [sample.frame for sample in path.samples] == ([0, 2, 5, 7] if has_times else [0] * 4)
    write_path(tmp_path / "transforms_new.json", path, SIZE, SCENE)
    again = read_path(tmp_path / "transforms_new.json", SCENE)
    assert_same_cameras(again, expected)
    assert [sample.frame for sample in again.samples] == [sample.frame for sample in path.samples]
    assert again.has_frames == has_times


def change(**values: object) -> Callable[[Content], None]:
    return lambda content: content.update(values)


def change_image(**values: object) -> Callable[[Content], None]:
    return lambda content: content["camera_path"][1].update(values)


@pytest.mark.parametrize(
    ("break_file", "message"),
    [
        (
            change_image(camera_to_world=[1.0] * 12),
            r"camera_path\[1\], camera_to_world: expected a list of",
        ),
        (change_image(camera_to_world=[2.0] * 16), r"camera_path\[1\], camera_to_world: expected a rotation"),
        (change_image(camera_to_world=np.diag([1.0, 1, -1, 1]).ravel().tolist()), "got a matrix of determinant -1"),
        (change_image(fov=0), r"camera_path\[1\], fov: expected a number > 0"),
        (change_image(fov="wide"), r"camera_path\[1\], fov: expected a number, got 'wide'"),
        (change(camera_type="vr180"), "camera_type: expected a value that is possible here, got 'vr180'"),
        (change(render_width=1e9), "render_width: expected a number <= 16384"),
        (change(camera_path=7), "camera_path: expected a list, got 7"),
        (change(camera_path=[], keyframes=[]), "keyframes: expected a list of length >= 1"),
    ],
)
def test_broken_files_are_one_line(break_file: Callable[[Content], None], message: str, tmp_path: Path) -> None:
    """Catches a traceback, or a message without the place in the file."""
    export = viewer_export([camera_to_world(camera) for camera in cameras()])
    break_file(export)
    with pytest.raises(UserError, match=message) as caught:
        read_path(write(tmp_path / "a.json", export), SCENE)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(
        f"{tmp_path / 'a.json'}: expected a camera path recorded by nerfstudio's viewer"
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"frames": []}, "expected a list 'frames' of entries with poses"),
        ({"frames": [{"transform_matrix": [[1]], "w": 9, "h": 9, "fl_x": 9}]}, "transform_matrix"),
        ({"frames": [{"transform_matrix": np.eye(4).tolist(), "fl_x": 9}]}, "file_path"),
        ({"hello": 1}, "expected a path of fourd's window or page, a camera path of nerfstudio, or a transforms.json"),
        ([], "expected a path of fourd's window or page"),
        ({"format": "fourd-path", "version": 3}, "version: expected"),
    ],
)
def test_other_files_are_one_line(content: object, message: str, tmp_path: Path) -> None:
    """Catches a traceback for a file of another kind."""
    with pytest.raises(UserError, match=message) as caught:
        read_path(write(tmp_path / "a.json", content), SCENE)
    assert "\n" not in str(caught.value)


def test_broken_worlds_are_one_line(tmp_path: Path) -> None:
    """Catches a traceback for a file that is no dataparser_transforms.json."""
    path = tmp_path / "world.json"
    for content, message in (
        ({}, 'expected nerfstudio\'s dataparser_transforms.json, got another file (expected a key "transform"'),
        ({"transform": np.zeros((3, 4)).tolist(), "scale": 1.0}, "transform: expected a rotation"),
        ({"transform": np.eye(4)[:3].tolist(), "scale": 0.0}, "scale: expected a number > 1e-09"),
    ):
        with pytest.raises(UserError) as caught:
            read_world([write(path, content)])
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match="got 'no such file or directory'"):
        read_world([tmp_path / "none.json"])
    with pytest.raises(UserError, match="got 3 files"):
        read_world([path] * 3)


def test_worlds_are_inverted_and_composed() -> None:
    """Catches a wrong order of scale, turn and shift."""
    rng = np.random.default_rng(0)
    one, two = (
        World(Rotation.random(random_state=seed).as_matrix(), scale, rng.normal(size=3))
        for seed, scale in ((1, 2.5), (2, 0.3))
    )
    point = rng.normal(size=3)

    def mapped(world: World, x: np.ndarray) -> np.ndarray:
        return world.scale * world.rotation @ x + world.shift

    np.testing.assert_allclose(mapped(one @ two, point), mapped(one, mapped(two, point)))
    np.testing.assert_allclose(mapped(one.inverse(), mapped(one, point)), point)
