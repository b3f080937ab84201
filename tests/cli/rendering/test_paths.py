"""`fourd render --path` with files: the same images again, times, and other calibrations."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fourd.base.cameras import Camera
from fourd.cli.main import main
from fourd.recording.capture.calibration import write_calibration
from fourd.scene import open_scene
from fourd.viewer.camera_paths.keys import KeyedPath, KeyFrame
from fourd.viewer.camera_paths.plan import played_frames
from fourd.viewer.navigation.pose import pose_from_camera
from tests.baking.scenes import write_scene
from tests.viewer.camera_paths.exports import SIZE, camera_to_world, cameras, viewer_export, write

BLACK = ("--background", "0", "0", "0")
FRAMES = 8


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.4dv"
    write_scene(path, frames=FRAMES, points=120)
    return path


def render(scene: Path, *words: object) -> None:
    assert main(["render", str(scene), *(str(word) for word in words)]) == 0


def images(folder: Path) -> list[np.ndarray]:
    return [np.asarray(Image.open(path)) for path in sorted(folder.glob("*.png"))]


def error(capsys: pytest.CaptureFixture[str], scene: Path, *words: object) -> str:
    capsys.readouterr()
    assert main(["render", str(scene), *(str(word) for word in words)]) == 2
    message = capsys.readouterr().err
    *notes, last = message.splitlines()
    assert all(note.startswith("lens distortion") for note in notes), message
    return last


def shown(scene: Path, folder: Path, camera: Camera) -> list[int]:
    """The index of the frame that each image of ``folder`` shows from ``camera``."""
    with open_scene(scene) as opened:
        truths = [opened.render(camera, frame).to_uint8().astype(int) for frame in range(FRAMES)]
    return [int(np.argmin([np.abs(image - truth).sum() for truth in truths])) for image in images(folder)]


def keyed_path(scene: Path, path: Path, *, has_frames: bool = True) -> Path:
    """Write a path through three cameras of the scene, of 7 images per second."""
    with open_scene(scene) as opened:
        manifest = opened.manifest
    poses = [pose_from_camera(each, manifest.focus, np.array([0.0, 0, 1]), SIZE) for each in manifest.cameras[:3]]
    keys = [KeyFrame(pose, float(i), 3.5 * i if has_frames else None) for i, pose in enumerate(poses)]
    KeyedPath(tuple(keys), 7.0).save(path)
    return path


def still_path(path: Path) -> Path:
    """Write a path of nerfstudio without times, of 12 images per second, whose camera rests."""
    return write(path, viewer_export([camera_to_world(cameras()[0])] * 24))


def test_a_file_of_nerfstudio_renders(scene: Path, tmp_path: Path) -> None:
    """Catches images of another view, size or frame than the file states."""
    export = viewer_export([camera_to_world(camera) for camera in cameras()], [0.0, 0.3, 0.6, 1.0])
    render(scene, "--path", write(tmp_path / "a.json", export), *BLACK, "-o", tmp_path / "out")
    found = images(tmp_path / "out")
    assert len(found) == 4
    with open_scene(scene) as opened:
        for image, camera, frame in zip(found, cameras(), (0, 2, 4, 7), strict=True):
            assert np.abs(image.astype(int) - opened.render(camera, frame).to_uint8()).max() <= 1


@pytest.mark.parametrize("name", ["again.path.json", "nerfstudio.json", "transforms.json"])
def test_a_written_path_gives_the_same_images_again(name: str, scene: Path, tmp_path: Path) -> None:
    """Catches numbers that lose digits, frames that are rounded otherwise, and a size that is lost."""
    keys = keyed_path(scene, tmp_path / "keys.path.json")
    render(scene, "--path", keys, "--size", *SIZE, "-o", tmp_path / "one")
    render(scene, "--path", keys, "--size", *SIZE, "-o", tmp_path / "two")
    render(scene, "--path", keys, "--size", *SIZE, "-o", tmp_path / name)
    render(scene, "--path", tmp_path / name, "--size", *SIZE, "-o", tmp_path / "three")
    one, two, three = (images(tmp_path / each) for each in ("one", "two", "three"))
    assert len(one) == len(two) == len(three) == 15
    for first, again, written in zip(one, two, three, strict=True):
        np.testing.assert_array_equal(first, again)
        assert np.abs(first.astype(int) - written).max() <= 1
    assert not np.array_equal(one[0], one[7])


def test_frozen_slow_and_reversed(scene: Path, tmp_path: Path) -> None:
    """Catches a frame that moves in bullet time, slow motion that skips frames, and a scene that jumps at its end."""
    path, camera = still_path(tmp_path / "still.json"), cameras()[0]
    render(scene, "--path", path, "--freeze", 13, *BLACK, "-o", tmp_path / "frozen")
    assert shown(scene, tmp_path / "frozen", camera) == [3] * 24
    # The scene has 24 frames per second, and the path 12 images per second.
    render(scene, "--path", path, "--speed", 0.25, *BLACK, "-o", tmp_path / "slow")
    assert shown(scene, tmp_path / "slow", camera) == [step // 2 % FRAMES for step in range(24)]
    render(scene, "--path", path, "--speed", 0.5, "--ping-pong", "--steps", 9, *BLACK, "-o", tmp_path / "back")
    assert shown(scene, tmp_path / "back", camera) == [0, 1, 2, 3, 4, 5, 6, 7, 6, 5, 4, 3, 2, 1, 0, 1]


def test_slow_motion_of_a_path_with_frames_has_more_images(scene: Path, tmp_path: Path) -> None:
    """Catches a camera that keeps its speed while the frames that the file states slow down."""
    keys = keyed_path(scene, tmp_path / "keys.path.json")
    render(scene, "--path", keys, "--speed", 0.5, "--size", 32, 32, "-o", tmp_path / "out")
    assert len(images(tmp_path / "out")) == 30
    render(scene, "--path", keys, "--ping-pong", "--size", 32, 32, "-o", tmp_path / "back")
    there_and_back = images(tmp_path / "back")
    assert len(there_and_back) == 28
    np.testing.assert_array_equal(there_and_back[1], there_and_back[-1])


def test_played_frames() -> None:
    """Catches rounding that skips a frame at rates such as 1/3, and frames that --frames leaves out."""
    assert played_frames(9, range(3), 1 / 3) == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert played_frames(6, [4, 6, 8], 1.0, is_ping_pong=True) == [4, 6, 8, 6, 4, 6]
    assert played_frames(3, [4], 1.0, is_ping_pong=True) == [4, 4, 4]


def test_images_of_another_calibration(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches images of the scene's own cameras, and a lens distortion that is rendered or goes unmentioned."""
    first, second = cameras(2)
    bent = Camera(second.intrinsics, second.rotation, second.translation, *SIZE, np.array([0.2, 0, 0, 0, 0]))
    write_calibration(tmp_path, ("a", "b"), (first, bent))
    words = ("--frames", "12:13", *BLACK)
    render(scene, "--cameras", tmp_path, *words, "-o", tmp_path / "out")
    assert "lens distortion of 1 cameras: not rendered" in " ".join(capsys.readouterr().err.split())
    with open_scene(scene) as opened:
        for name, camera in (("a", first), ("b", second)):
            image = np.asarray(Image.open(tmp_path / "out" / name / "000012.png")).astype(int)
            assert np.abs(image - opened.render(camera, 2).to_uint8()).max() <= 1
    for name in ("intri", "extri"):
        shutil.move(tmp_path / f"{name}.yml", tmp_path / f"other_{name}.yml")
    files = f"{tmp_path / 'other_intri.yml'},{tmp_path / 'other_extri.yml'}"
    render(scene, "--cameras", files, "--views", "b", *words, "-o", tmp_path / "two")
    assert [path.name for path in (tmp_path / "two").iterdir()] == ["b"]
    render(scene, "--cameras", files, "--path", "cameras", "--steps", 2, "-o", tmp_path / "three")
    assert images(tmp_path / "three")[0].shape == (SIZE[1], SIZE[0], 3)
    words = ("-o", tmp_path / "four")
    assert "expected names out of a, b, got c" in error(capsys, scene, "--cameras", files, "--views", "c", *words)
    assert "other_intri.yml: expected" not in error(capsys, scene, "--cameras", tmp_path, *words)
    one = error(capsys, scene, "--cameras", tmp_path / "other_intri.yml", *words)
    assert "expected a folder with intri.yml and extri.yml, or both files separated by a comma, got one file" in one


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--path", "KEYS", "--frames", "10:12"], "expected no --frames, because the file says which frames are shown"),
        (["--path", "KEYS", "--steps", "4", "--speed", "0.5"], "--speed, --steps: expected one of them"),
        (["--path", "orbit", "--freeze", "3"], "--freeze: expected a frame from 10 to 17, got 3"),
        (["--path", "orbit", "--freeze", "12", "--frames", "10:12"], "--freeze, --frames: expected one of them"),
        (["--path", "orbit", "--speed", "0"], "--speed: expected 0.001 to 1000, got 0"),
        (["--views", "01", "--freeze", "12"], "expected --path with them, got none; add --path"),
        (["--path", "orbit", "--path-world", "none.json"], "--path-world none.json: expected dataparser_transforms"),
        (["--path", "WIDE"], "expected --lens panorama, for which the path was made, got none; add it"),
        (["--views", "01", "--path", "orbit"], "--views, --path: expected exactly one of them"),
        (["--views", "01", "-o", "new.json"], "new.json: expected --path for a path file, got none"),
        (["--path", "KEYS", "-o", "KEYS"], "expected an output that is not an input"),
    ],
)
def test_wrong_options_are_one_line(
    words: list[str], message: str, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches options that have no effect and go unmentioned, and a path file that is replaced by itself."""
    export = viewer_export([camera_to_world(camera) for camera in cameras()]) | {"camera_type": "equirectangular"}
    files = {"KEYS": keyed_path(scene, tmp_path / "keys.json"), "WIDE": write(tmp_path / "wide.json", export)}
    given = [str(files.get(word, word)) for word in words]
    assert message in error(capsys, scene, *given, *([] if "-o" in given else ["-o", tmp_path / "out"]))
    assert json.loads(files["KEYS"].read_text())["version"] == 2
    assert not (tmp_path / "out").exists()
