"""Wording and small conveniences of the commands, on a small scene without training."""

from __future__ import annotations

import json
import shutil
import socket
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fourd.base.progress import format_minutes
from fourd.cli.main import main
from fourd.cli.scenes.serve import listen
from fourd.scene import open_scene
from fourd.viewer.navigation.pose import pose_from_camera
from fourd.viewer.navigation.recorded_path import PathSample, RecordedPath
from fourd.viewer.publish.server import SiteServer
from tests.baking.scenes import write_scene


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    write_scene(tmp_path / "scene.4dv")
    return tmp_path / "scene.4dv"


def printed(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> str:
    """Run a command, and return its output on one line."""
    assert main([str(word) for word in words]) == code
    output = capsys.readouterr()
    return " ".join((output.out + output.err).split())


def test_one_image_is_not_called_images(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``fourd render`` printed "1 images"."""
    words = ("render", scene, "--path", "orbit", "--out", tmp_path / "out", "--size", 32, 32, "--steps")
    assert printed(capsys, *words, 1).endswith("out: 1 image")
    assert printed(capsys, *words, 2).endswith("out: 2 images")


@pytest.mark.parametrize("style", ["", "gooch"])
def test_a_transparent_image_over_a_colour_is_the_image_with_that_background(
    style: str, scene: Path, tmp_path: Path
) -> None:
    """Catches an alpha channel that is premultiplied twice, or that covers pixels without points. Also catches a style
    whose paper hides the background that was asked for."""
    words = [
        "render",
        str(scene),
        "--views",
        "01",
        "--frames",
        "10:11",
        *(["--style", style] if style else []),
        "--out",
    ]
    colour = ["--background", "0.2", "0.6", "0.4"]
    assert main([*words, str(tmp_path / "clear"), "--transparent"]) == 0
    assert main([*words, str(tmp_path / "green"), *colour]) == 0
    [clear] = (tmp_path / "clear").rglob("*.png")
    [green] = (tmp_path / "green").rglob("*.png")
    rgba = np.asarray(Image.open(clear)).astype(float) / 255
    assert rgba.shape[2] == 4
    assert rgba[0, 0, 3] == 0
    assert rgba[..., 3].max() > 0.5
    if style:
        assert np.abs(np.asarray(Image.open(green))[0, 0] / 255 - [0.2, 0.6, 0.4]).max() < 1 / 255
        return
    over = rgba[..., :3] * rgba[..., 3:] + (1 - rgba[..., 3:]) * [0.2, 0.6, 0.4]
    difference = np.abs(over - np.asarray(Image.open(green)) / 255)
    # A pixel whose filtered colour is brighter than its alpha allows cannot be stored with straight alpha.
    assert difference.max() < 0.05
    assert (difference > 3 / 255).mean() < 0.005


def test_a_transparent_screenshot_has_an_alpha_channel(scene: Path, tmp_path: Path) -> None:
    """Catches --transparent that has no effect on the screenshots of ``fourd view``."""
    out = tmp_path / "shot.png"
    assert main(["view", str(scene), "--screenshot", str(out), "--renderer", "cpu", "--transparent"]) == 0
    rgba = np.asarray(Image.open(out))
    assert rgba.shape[2] == 4
    assert rgba[0, 0, 3] == 0
    assert rgba[..., 3].max() > 128


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["render", "SCENE", "--path", "orbit", "--out", "turn.mp4", "--transparent"],
            "--transparent: expected a folder of PNG files, got turn.mp4; name a folder with --out",
        ),
        (
            ["view", "SCENE", "--headless", "turn.mp4", "--transparent"],
            "--transparent: expected --screenshot FILE.png alone, got another output; videos have no alpha",
        ),
    ],
)
def test_videos_are_not_transparent(
    words: list[str], message: str, scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a video with a black background where the user asked for none."""
    assert main([word.replace("SCENE", str(scene)) for word in words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_render_follows_a_recorded_path(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``fourd render --path`` did not take the file that ``fourd view --headless --path`` takes."""
    with open_scene(scene) as opened:
        manifest = opened.manifest
    size = (48, 48)
    poses = [
        pose_from_camera(camera, manifest.focus, np.array([0.0, 0, 1]), size) for camera in manifest.source_cameras
    ]
    path = tmp_path / "path.json"
    RecordedPath(tuple(PathSample(pose, 1) for pose in poses[:3])).save(path)
    words = ["render", str(scene), "--path", str(path), "--size", "48", "48", "--out", str(tmp_path / "out")]
    words += ["--background", "0", "0", "0"]
    assert main(words) == 0
    written = sorted((tmp_path / "out").glob("*.png"))
    assert len(written) == 3
    with open_scene(scene) as opened:
        truth = opened.render(poses[2].camera(*size), 1).to_uint8()
    assert np.abs(np.asarray(Image.open(written[2])).astype(int) - truth).max() <= 1
    assert "expected no --frames, because the file says" in printed(capsys, *words, "--frames", "10:12", code=2)
    words[3] = "circle"
    expected = "--path: expected orbit, spiral, cameras or a path file, got 'circle'"
    assert expected in printed(capsys, *words, code=2)


def test_a_busy_port_is_followed_by_the_next(tmp_path: Path) -> None:
    """``fourd serve`` ended with an error if another program used port 8000."""
    lines: list[str] = []
    with SiteServer(tmp_path) as first:
        port = first.server_address[1]
        with listen(lambda tried: SiteServer(tmp_path, port=tried), port, lines.append) as second:
            assert second.server_address[1] > port
            assert lines == [f"port {port} is in use, so this is port {second.server_address[1]}"]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with listen(lambda tried: SiteServer(tmp_path, port=tried), port, lines.append):
        assert len(lines) == 1


def test_info_knows_a_page_and_a_folder_with_several_things(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """``fourd info`` did not know the folder of ``fourd web``, nor a folder with scenes and captures."""
    site = tmp_path / "site"
    assert main(["web", str(scene), "-o", str(site)]) == 0
    text = printed(capsys, "info", site)
    assert "a web page that plays a scene" in text
    assert text.endswith(f"next: fourd serve {site}")
    (tmp_path / "notes.txt").write_text("nothing")
    text = printed(capsys, "info", tmp_path)
    assert "a folder with 2 things that fourd knows" in text
    assert "scene.4dv a 4D scene, " in text
    assert "site a web page that plays a scene, " in text
    shutil.rmtree(site)
    scene.unlink()
    assert "got none of these" in printed(capsys, "info", tmp_path, code=2)


def test_info_describes_a_run_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``fourd info RUN`` listed eight numbers of the log with their internal names."""
    run = tmp_path / "scene.work" / "run"
    run.mkdir(parents=True)
    (run / "config.yaml").write_text("capture: clips\n")
    row = {"step": 301, "psnr": 31.0, "psnr_smooth": 32.04, "seconds": 331.0, "rate_factor": 0.1, "loss/image": 0.2}
    (run / "metrics.jsonl").write_text(json.dumps(row) + "\n")
    assert "last measured step 301 after 5:31: 32.0 dB on training views" in printed(capsys, "info", run)
    text = printed(capsys, "info", run.parent)
    assert "the work folder of fourd make" in text
    assert "run a training run, " in text


def test_minutes_are_short() -> None:
    """Catches 0:05:31 where 5:31 is meant, and an hour that is missing."""
    assert [format_minutes(seconds) for seconds in (5, 331, 3600, 600)] == ["0:05", "5:31", "1:00:00", "10:00"]
