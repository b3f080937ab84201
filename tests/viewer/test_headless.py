"""Pictures and videos without a window, and every input that cannot be shown, from the command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fourd.baking import SceneWriter, open_scene
from fourd.baking.scene import FORMAT_VERSION
from fourd.cli.main import main
from fourd.viewer.navigation.pose import pose_from_camera
from fourd.viewer.navigation.recorded_path import PathSample, RecordedPath
from fourd.viewer.rendering.offscreen import OffscreenRenderer
from fourd.viewer.rendering.renderers import RENDERERS
from tests.baking.scenes import manifest, random_frame
from tests.viewer.gl import require_gl
from tests.viewer.scenes import write_shells
from tests.viewer.screen import screen

FRAMES = 4


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("headless") / "ball.4dv"
    write_shells(path, FRAMES, points=800)
    return path


def run(*words: object) -> None:
    assert main(["view", *(str(word) for word in words)]) == 0


def complaint(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line that the command ends with."""
    assert main(["view", *(str(word) for word in words)]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("fourd ")]
    assert len(lines) == 1
    return lines[0]


def png(path: Path) -> NDArray[np.uint8]:
    return np.asarray(Image.open(path))


def frames_of(path: Path) -> list[NDArray[np.uint8]]:
    with av.open(str(path)) as video:
        return [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]


@pytest.mark.parametrize("name", RENDERERS)
def test_a_screenshot_is_what_the_scene_renders(name: str, scene: Path, tmp_path: Path) -> None:
    """Catches a camera, frame, K or background of the command that does not reach the renderer."""
    if name != "cpu":
        require_gl()
    out = tmp_path / "seen.png"
    words = ("--camera", "held out", "--frame", 2, "--layers", 9, "--background", 0.4, 0.2, 0.6)
    run(scene, "--screenshot", out, "--renderer", name, *words)
    with open_scene(scene) as opened:
        camera = opened.manifest.camera("held out")
        truth = opened.render(camera, 2, layers=9, background=np.array([0.4, 0.2, 0.6], np.float32)).to_uint8()
    difference = np.abs(png(out).astype(float) - truth)
    assert difference.shape == truth.shape
    assert difference.mean() < 1.0
    assert (difference.max(axis=2) > 5).mean() < (0.03 if name == "sorted" else 1e-3)


@pytest.mark.parametrize("kind", ["orbit", "spiral", "cameras"])
def test_videos_along_paths(kind: str, scene: Path, tmp_path: Path) -> None:
    """Catches a path that stands still, and a size or length other than asked for."""
    out = tmp_path / "out.mp4"
    run(scene, "--headless", out, "--path", kind, "--steps", 6, "--size", 64, 48, "--fps", 12)
    pictures = frames_of(out)
    assert len(pictures) == 6
    assert pictures[0].shape == (48, 64, 3)
    assert all((picture.max(axis=2) > 30).mean() > 0.02 for picture in pictures), "nothing is seen"
    assert not np.array_equal(pictures[0], pictures[3])


def test_a_video_along_a_recorded_path(scene: Path, tmp_path: Path) -> None:
    """Catches a recorded path that is flown elsewhere, or with other frames; and frames that the scene lacks."""
    with open_scene(scene) as opened:
        seen = opened.manifest
        poses = [pose_from_camera(camera, seen.focus, np.array([0.0, 0, 1]), (48, 48)) for camera in seen.cameras[:3]]
        flight = RecordedPath(
            tuple(PathSample(pose, frame) for pose, frame in zip(poses, (0, 2, 99), strict=True)), 10.0
        )
        truths = [
            opened.render(pose.camera(48, 48), min(stop.frame, FRAMES - 1)).to_uint8()
            for pose, stop in zip(poses, flight.samples, strict=True)
        ]
    flight.save(tmp_path / "flight.path.json")
    run(scene, "--headless", tmp_path / "out.mp4", "--path", tmp_path / "flight.path.json", "--size", 48, 48)
    for picture, truth in zip(frames_of(tmp_path / "out.mp4"), truths, strict=True):
        assert np.abs(picture.astype(float) - truth).mean() < 12, "beyond what the video's compression loses"


def test_scenes_without_cameras_are_seen_as_a_whole(tmp_path: Path) -> None:
    """Catches a start that needs a capture camera."""
    bare = replace(manifest(2, 1), source_names=(), source_cameras=(), other_names=(), other_cameras=(), sh_base=0.7)
    frame = random_frame(300, 0, seed=1)
    with SceneWriter(tmp_path / "bare.4dv", bare) as writer:
        writer.add_frame(0, frame)
    run(tmp_path / "bare.4dv", "--screenshot", tmp_path / "bare.png", "--size", 64, 64)
    assert 0.02 < (png(tmp_path / "bare.png").max(axis=2) > 30).mean() < 0.9
    run(tmp_path / "bare.4dv", "--headless", tmp_path / "bare.mp4", "--steps", 2, "--size", 32, 32)
    assert len(frames_of(tmp_path / "bare.mp4")) == 2


def test_auto_says_what_it_took_and_why(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a choice that is not told."""
    run(scene, "--screenshot", tmp_path / "seen.png")
    assert "renderer: " in capsys.readouterr().err
    with OffscreenRenderer("cpu") as offscreen:
        assert (offscreen.choice.name, offscreen.choice.reason) == ("cpu", "as requested")


def rewritten(scene: Path, out: Path, change) -> Path:
    """The scene with its manifest changed by ``change``."""
    with zipfile.ZipFile(scene) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "manifest.json":
                described = json.loads(content)
                change(described)
                content = json.dumps(described).encode()
            new.writestr(name, content)
    return out


def test_scenes_that_cannot_be_shown(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback, or a message without the file and the mend."""
    out = tmp_path / "never.png"
    cut = tmp_path / "cut.4dv"
    cut.write_bytes(scene.read_bytes()[:5000])
    assert "cut.4dv: expected a complete .4dv scene" in complaint(capsys, cut, "--screenshot", out)
    newer = rewritten(scene, tmp_path / "newer.4dv", lambda content: content.update(version=FORMAT_VERSION + 1))
    assert "update fourd to open this newer scene" in complaint(capsys, newer, "--screenshot", out)
    lying = rewritten(scene, tmp_path / "lying.4dv", lambda content: content["frames"][1].update(points=801))
    assert "by the manifest, got" in complaint(capsys, lying, "--screenshot", out)
    empty = rewritten(scene, tmp_path / "empty.4dv", lambda content: content.update(frames=[]))
    assert "empty.4dv: expected at least one frame, got a scene without frames" in complaint(
        capsys, empty, "--screenshot", out
    )
    with SceneWriter(tmp_path / "bare.4dv", manifest(6, 2)) as writer:
        for index in range(2):
            writer.add_frame(index, random_frame(0, 6, seed=1))
    assert "expected points in some frame" in complaint(capsys, tmp_path / "bare.4dv", "--screenshot", out)
    assert "got nothing there; check the path" in complaint(capsys, tmp_path / "no.4dv", "--screenshot", out)
    assert "expected a run" in complaint(capsys, tmp_path, "--screenshot", out)
    assert not out.exists()


def test_positions_that_are_not_finite(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches NaN that is render as if it were a place."""
    with zipfile.ZipFile(scene) as old, zipfile.ZipFile(tmp_path / "nan.4dv", "w", zipfile.ZIP_STORED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "frames/000001/xyz":
                content = np.float32(np.nan).tobytes() + content[4:]
            new.writestr(name, content)
    words = ("--screenshot", tmp_path / "never.png", "--frame", 1)
    assert "expected finite numbers in frames/000001/xyz" in complaint(capsys, tmp_path / "nan.4dv", *words)


def test_arguments_out_of_range(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches values that reach the renderer and fail there."""
    out = tmp_path / "never.png"
    video = tmp_path / "never.mp4"
    assert "--camera: expected a name among 00, 01" in complaint(capsys, scene, "--screenshot", out, "--camera", "x")
    assert "--frame: expected 0 to 3, got 4" in complaint(capsys, scene, "--screenshot", out, "--frame", 4)
    assert "--layers: expected 1 to 64, got 0" in complaint(capsys, scene, "--screenshot", out, "--layers", 0)
    assert "--size: expected 16 to" in complaint(capsys, scene, "--screenshot", out, "--size", 4, 4)
    assert "--background" in complaint(capsys, scene, "--screenshot", out, "--background", 2, 0, 0)
    assert "--path: expected orbit" in complaint(capsys, scene, "--headless", video, "--path", "circle")
    (tmp_path / "other.json").write_text("{}")
    told = complaint(capsys, scene, "--headless", video, "--path", tmp_path / "other.json")
    assert "other.json: expected a camera path recorded by the viewer" in told
    assert "SOURCE: expected" in complaint(capsys, "--screenshot", out)
    assert "--steps: expected at least 1" in complaint(capsys, scene, "--headless", video, "--steps", 0)
    assert not out.exists()
    assert not video.exists()


def in_a_process(environment: dict[str, str | None], *words: object) -> subprocess.CompletedProcess[str]:
    """`fourd view` with variables set, or taken away where they are None."""
    changed = {**os.environ, **{name: value for name, value in environment.items() if value is not None}}
    for name, value in environment.items():
        if value is None:
            changed.pop(name, None)
    command = [sys.executable, "-m", "fourd.cli.main", "view", *(str(word) for word in words)]
    return subprocess.run(command, env=changed, capture_output=True, text=True, timeout=60)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="displays are named by variables on Linux alone")
def test_no_display_is_told(scene: Path) -> None:
    """Catches a traceback of the window library on a server."""
    done = in_a_process({"DISPLAY": None, "WAYLAND_DISPLAY": None}, scene)
    assert done.returncode == 2
    assert done.stderr.startswith("fourd view: display: expected one to open a window on, got none")
    assert "add --headless FILE.mp4" in done.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="how OpenGL is taken away here")
def test_no_opengl_is_told_and_auto_does_without(scene: Path, tmp_path: Path) -> None:
    """Catches a machine without any driver that gets a traceback instead of a picture."""
    without = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/dev/null"}
    done = in_a_process(without, scene, "--screenshot", tmp_path / "a.png", "--renderer", "peel")
    assert done.returncode == 2
    assert "OpenGL: expected version 3.3 or newer, got" in done.stderr
    assert "add --renderer cpu" in done.stderr
    done = in_a_process(without, scene, "--screenshot", tmp_path / "b.png")
    assert done.returncode == 0, done.stderr
    assert "renderer: cpu (OpenGL is not available)" in done.stderr
    assert png(tmp_path / "b.png").any()


def test_a_display_without_opengl_is_told(scene: Path) -> None:
    """Catches a traceback where windows can be opened, but none with OpenGL in it."""
    with screen(options=("-extension", "GLX")) as bare:
        done = in_a_process({**bare.environment(), "__EGL_VENDOR_LIBRARY_FILENAMES": "/dev/null"}, scene)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("fourd view: OpenGL: expected version 3.3 core for a window, got")
