"""The command ``fourd view`` without a window: images, videos and errors for invalid inputs."""

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

from fourd.cli.main import main
from fourd.scene import SceneWriter, open_scene
from fourd.scene.scene import FORMAT_VERSION
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


def error_line(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Run ``fourd view`` and return the only error line that the command prints."""
    assert main(["view", *(str(word) for word in words)]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("fourd ")]
    assert len(lines) == 1
    return lines[0]


def read_png(path: Path) -> NDArray[np.uint8]:
    return np.asarray(Image.open(path))


def read_video(path: Path) -> list[NDArray[np.uint8]]:
    with av.open(str(path)) as video:
        return [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]


@pytest.mark.parametrize("name", RENDERERS)
def test_screenshots_match_the_float_renderer(name: str, scene: Path, tmp_path: Path) -> None:
    """Catches an option --camera, --frame, --layers or --background that has no effect."""
    if name != "cpu":
        require_gl()
    out = tmp_path / "image.png"
    words = ("--camera", "held out", "--frame", 2, "--layers", 9, "--background", 0.4, 0.2, 0.6)
    run(scene, "--screenshot", out, "--renderer", name, *words)
    with open_scene(scene) as opened:
        camera = opened.manifest.camera("held out")
        truth = opened.render(camera, 2, layers=9, background=np.array([0.4, 0.2, 0.6], np.float32)).to_uint8()
    difference = np.abs(read_png(out).astype(float) - truth)
    assert difference.shape == truth.shape
    assert difference.mean() < 1.0
    assert (difference.max(axis=2) > 5).mean() < (0.03 if name == "sorted" else 1e-3)


@pytest.mark.parametrize("kind", ["orbit", "spiral", "cameras"])
def test_videos_along_paths(kind: str, scene: Path, tmp_path: Path) -> None:
    """Catches a video whose camera does not move, or whose size or length is wrong."""
    out = tmp_path / "out.mp4"
    run(scene, "--headless", out, "--path", kind, "--steps", 6, "--size", 64, 48, "--fps", 12)
    images = read_video(out)
    assert len(images) == 6
    assert images[0].shape == (48, 64, 3)
    assert all((image.max(axis=2) > 30).mean() > 0.02 for image in images), "an image is empty"
    assert not np.array_equal(images[0], images[3])


def test_a_video_along_a_recorded_path(scene: Path, tmp_path: Path) -> None:
    """Catches a video whose poses or frames differ from the recorded path, and an error for recorded frames that the
    scene does not have.
    """
    with open_scene(scene) as opened:
        focus, cameras = opened.manifest.focus, opened.manifest.cameras[:3]
        poses = [pose_from_camera(camera, focus, np.array([0.0, 0, 1]), (48, 48)) for camera in cameras]
        recorded = RecordedPath(
            tuple(PathSample(pose, frame) for pose, frame in zip(poses, (0, 2, 99), strict=True)), 10.0
        )
        truths = [
            opened.render(pose.camera(48, 48), min(sample.frame, FRAMES - 1)).to_uint8()
            for pose, sample in zip(poses, recorded.samples, strict=True)
        ]
    recorded.save(tmp_path / "recorded.path.json")
    words = ("--path", tmp_path / "recorded.path.json", "--size", 48, 48, "--background", 0, 0, 0)
    run(scene, "--headless", tmp_path / "out.mp4", *words)
    for image, truth in zip(read_video(tmp_path / "out.mp4"), truths, strict=True):
        assert np.abs(image.astype(float) - truth).mean() < 12, "more than the loss of video compression"


def test_scenes_without_cameras_are_shown_as_a_whole(tmp_path: Path) -> None:
    """Catches an error for a scene without capture cameras, because the initial pose depends on a camera."""
    bare = replace(manifest(2, 1), source_names=(), source_cameras=(), other_names=(), other_cameras=(), sh_base=0.7)
    frame = random_frame(300, 0, seed=1)
    with SceneWriter(tmp_path / "bare.4dv", bare) as writer:
        writer.add_frame(0, frame)
    run(tmp_path / "bare.4dv", "--screenshot", tmp_path / "bare.png", "--size", 64, 64)
    assert 0.02 < (read_png(tmp_path / "bare.png").max(axis=2) > 30).mean() < 0.9
    run(tmp_path / "bare.4dv", "--headless", tmp_path / "bare.mp4", "--steps", 2, "--size", 32, 32)
    assert len(read_video(tmp_path / "bare.mp4")) == 2


def test_the_chosen_renderer_is_printed(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an automatic choice of the renderer that is not printed."""
    run(scene, "--screenshot", tmp_path / "image.png")
    assert "renderer: " in capsys.readouterr().err
    with OffscreenRenderer("cpu") as offscreen:
        assert (offscreen.choice.name, offscreen.choice.reason) == ("cpu", "as requested")


def rewrite_manifest(scene: Path, out: Path, change) -> Path:
    """Write a copy of the scene. The function ``change`` changes the manifest of the copy."""
    with zipfile.ZipFile(scene) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "manifest.json":
                manifest_json = json.loads(content)
                change(manifest_json)
                content = json.dumps(manifest_json).encode()
            new.writestr(name, content)
    return out


def test_invalid_scenes_raise_one_line_errors(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an invalid scene that causes a traceback, or an error message without the file and the fix."""
    out = tmp_path / "never.png"
    cut = tmp_path / "cut.4dv"
    cut.write_bytes(scene.read_bytes()[:5000])
    assert "cut.4dv: expected a complete .4dv scene" in error_line(capsys, cut, "--screenshot", out)
    newer = rewrite_manifest(scene, tmp_path / "newer.4dv", lambda content: content.update(version=FORMAT_VERSION + 1))
    assert "update fourd to open this newer scene" in error_line(capsys, newer, "--screenshot", out)
    inconsistent = rewrite_manifest(
        scene, tmp_path / "inconsistent.4dv", lambda content: content["frames"][1].update(points=801)
    )
    assert "according to the manifest, got" in error_line(capsys, inconsistent, "--screenshot", out)
    empty = rewrite_manifest(scene, tmp_path / "empty.4dv", lambda content: content.update(frames=[]))
    assert "empty.4dv: expected at least one frame, got a scene without frames" in error_line(
        capsys, empty, "--screenshot", out
    )
    with SceneWriter(tmp_path / "bare.4dv", manifest(6, 2)) as writer:
        for index in range(2):
            writer.add_frame(index, random_frame(0, 6, seed=1))
    assert "expected points in at least one frame" in error_line(capsys, tmp_path / "bare.4dv", "--screenshot", out)
    assert "got nothing there; check the path" in error_line(capsys, tmp_path / "no.4dv", "--screenshot", out)
    assert "expected a run" in error_line(capsys, tmp_path, "--screenshot", out)
    assert not out.exists()


def test_positions_that_are_not_finite_raise(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches NaN positions that reach the renderer."""
    with zipfile.ZipFile(scene) as old, zipfile.ZipFile(tmp_path / "nan.4dv", "w", zipfile.ZIP_STORED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "frames/000001/xyz":
                content = np.float32(np.nan).tobytes() + content[4:]
            new.writestr(name, content)
    words = ("--screenshot", tmp_path / "never.png", "--frame", 1)
    assert "expected finite numbers in frames/000001/xyz" in error_line(capsys, tmp_path / "nan.4dv", *words)


def test_arguments_out_of_range_raise(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches invalid option values that cause an error only inside the renderer."""
    out = tmp_path / "never.png"
    video = tmp_path / "never.mp4"
    assert "--camera: expected a name among 00, 01" in error_line(capsys, scene, "--screenshot", out, "--camera", "x")
    assert "--frame: expected 0 to 3, got 4" in error_line(capsys, scene, "--screenshot", out, "--frame", 4)
    assert "--layers: expected 1 to 64, got 0" in error_line(capsys, scene, "--screenshot", out, "--layers", 0)
    assert "--size: expected 16 to" in error_line(capsys, scene, "--screenshot", out, "--size", 4, 4)
    assert "--background" in error_line(capsys, scene, "--screenshot", out, "--background", 2, 0, 0)
    assert "--path: expected orbit" in error_line(capsys, scene, "--headless", video, "--path", "circle")
    (tmp_path / "other.json").write_text("{}")
    message = error_line(capsys, scene, "--headless", video, "--path", tmp_path / "other.json")
    assert "other.json: expected a camera path recorded by the viewer" in message
    assert "SCENE|RUN: expected" in error_line(capsys, "--screenshot", out)
    assert "--steps: expected at least 1" in error_line(capsys, scene, "--headless", video, "--steps", 0)
    assert not out.exists()
    assert not video.exists()


def run_in_process(environment: dict[str, str | None], *words: object) -> subprocess.CompletedProcess[str]:
    """Run `fourd view` with changed environment variables. A value of None removes the variable."""
    changed = {**os.environ, **{name: value for name, value in environment.items() if value is not None}}
    for name, value in environment.items():
        if value is None:
            changed.pop(name, None)
    command = [sys.executable, "-m", "fourd.cli.main", "view", *(str(word) for word in words)]
    return subprocess.run(command, env=changed, capture_output=True, text=True, timeout=60)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux selects displays by variables")
def test_a_missing_display_raises_one_line(scene: Path) -> None:
    """Catches a traceback of the window library on a machine without a display."""
    done = run_in_process({"DISPLAY": None, "WAYLAND_DISPLAY": None}, scene)
    assert done.returncode == 2
    assert done.stderr.startswith("fourd view: display: expected a display for the window, got none")
    assert "add --headless FILE.mp4" in done.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="this way to disable OpenGL is specific to Linux")
def test_missing_opengl_raises_and_auto_uses_the_cpu(scene: Path, tmp_path: Path) -> None:
    """Catches a traceback on a machine without an OpenGL driver."""
    without = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/dev/null"}
    done = run_in_process(without, scene, "--screenshot", tmp_path / "a.png", "--renderer", "peel")
    assert done.returncode == 2
    assert "OpenGL: expected version 3.3 or newer, got" in done.stderr
    assert "add --renderer cpu" in done.stderr
    done = run_in_process(without, scene, "--screenshot", tmp_path / "b.png")
    assert done.returncode == 0, done.stderr
    assert "renderer: cpu (OpenGL is not available)" in done.stderr
    assert read_png(tmp_path / "b.png").any()


def test_a_display_without_opengl_raises_one_line(scene: Path) -> None:
    """Catches a traceback on a display without OpenGL."""
    with screen(options=("-extension", "GLX")) as bare:
        done = run_in_process({**bare.environment(), "__EGL_VENDOR_LIBRARY_FILENAMES": "/dev/null"}, scene)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("fourd view: OpenGL: expected version 3.3 core for a window, got")
