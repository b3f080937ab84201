"""Tests of commands with URLs instead of paths, on a local S3 server."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from fourd.cli.main import main
from fourd.scene import SceneReader
from tests.captures import write_ball_capture
from tests.storage.s3_server import Bucket, put_folder, unfinished_uploads

OVERLAY = """\
points: 500
model: {hidden: 8, planes: {levels: 1, features: 4, base_resolution: 8}}
"""


@pytest.fixture(scope="module")
def small_capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of a ball: 4 cameras, 2 frames, 48 x 48. The tests only need a capture that the commands accept."""
    return write_ball_capture(tmp_path_factory.mktemp("ball"), cameras=4, frames=2, size=48)


def run(*words: object) -> int:
    return main([str(word) for word in words])


def test_a_scene_is_made_from_and_in_a_bucket(
    bucket: Bucket,
    small_capture: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Catches a stage between capture and scene that uses a URL as a path or reads an outdated copy. Also catches a
    second upload of an unchanged scene.
    """
    monkeypatch.chdir(tmp_path)
    put_folder(bucket.files, small_capture, f"{bucket.name}/captures/ball")
    scene = f"{bucket.url}/scenes/ball.4dv"
    (tmp_path / "small.yaml").write_text(OVERLAY)
    words = ["make", f"{bucket.url}/captures/ball", "-o", scene, "--config", "small.yaml", "--max-steps", "3"]
    assert run(*words) == 0
    assert "fetch: finished (ball.work/source/ball)" in capsys.readouterr().out
    assert bucket.files.find(f"{bucket.name}/scenes") == [f"{bucket.name}/scenes/ball.4dv"]
    assert unfinished_uploads(bucket.files, bucket.name) == []
    whole = (tmp_path / "ball.work/ball.4dv").read_bytes()
    assert bucket.files.cat_file(f"{bucket.name}/scenes/ball.4dv") == whole
    before = bucket.files.info(f"{bucket.name}/scenes/ball.4dv")

    assert run(*words) == 0
    printed = capsys.readouterr().out
    assert printed.count("up to date") >= 4
    assert "running" not in printed.replace("check: running", "").replace("repair: running", "")
    assert bucket.files.info(f"{bucket.name}/scenes/ball.4dv") == before
    bucket.files.rm_file(f"{bucket.name}/scenes/ball.4dv")
    assert run(*words) == 0
    assert bucket.files.cat_file(f"{bucket.name}/scenes/ball.4dv") == whole
    capsys.readouterr()

    assert run("info", scene) == 0
    assert f"{scene}: a 4D scene" in capsys.readouterr().out.replace("\n", "")
    assert run("verify", scene) == 0
    assert capsys.readouterr().out == f"{scene}: whole; 2 frames\n"
    assert run("render", scene, "--views", "00", "--frames", "0:1", "-o", "pictures") == 0
    assert (tmp_path / "pictures/00/000000.png").exists()
    assert run("view", scene, "--screenshot", "one.png", "--renderer", "cpu") == 0
    assert (tmp_path / "one.png").exists()
    assert run("pack", scene, "-o", f"{bucket.url}/scenes/small.4dv") == 0
    bucket.files.get_file(f"{bucket.name}/scenes/small.4dv", str(tmp_path / "small.4dv"))
    assert SceneReader(tmp_path / "small.4dv").manifest.encoding is not None


def test_a_run_keeps_the_copy_of_its_capture(
    bucket: Bucket, small_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a run that cannot be resumed, evaluated or exported, because its capture was a temporary copy."""
    monkeypatch.chdir(tmp_path)
    put_folder(bucket.files, small_capture, f"{bucket.name}/ball")
    (tmp_path / "small.yaml").write_text(OVERLAY)
    words = ["train", f"{bucket.url}/ball", "-o", "run", "--config", "small.yaml", "--test-views", "03"]
    assert run(*words, "--max-steps", 2) == 0
    assert run(*words, "--max-steps", 3, "--resume") == 0
    assert (tmp_path / "run/source/ball/intri.yml").read_bytes() == (small_capture / "intri.yml").read_bytes()
    assert run("eval", "run", "--json", "scores.json") == 0
    assert run("export", "run", "-o", f"{bucket.url}/scene.4dv") == 0
    bucket.files.get_file(f"{bucket.name}/scene.4dv", str(tmp_path / "scene.4dv"))
    assert SceneReader(tmp_path / "scene.4dv").manifest.frame_count == 2


def test_check_and_info_describe_a_capture_in_a_bucket(
    bucket: Bucket, small_capture: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a report that names the temporary copy."""
    put_folder(bucket.files, small_capture, f"{bucket.name}/ball")
    assert run("check", f"{bucket.url}/ball", "--quick") == 0
    assert run("info", f"{bucket.url}/ball") == 0
    printed = capsys.readouterr().out
    assert f"{bucket.url}/ball: a multi-view capture" in printed.replace("\n", "")
    assert "/fourd-" not in printed


@pytest.mark.parametrize(
    "words", [["info", "URL"], ["train", "URL", "-o", "run", "--max-steps", "1"], ["make", "URL", "-o", "a.4dv"]]
)
def test_bad_storage_is_one_line(
    words: list[str],
    bucket: Bucket,
    new_connections: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Catches tracebacks, and error messages of several lines, for errors of the user."""
    monkeypatch.chdir(tmp_path)

    def refusal(url: str) -> str:
        assert run(*[url if word == "URL" else word for word in words]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1, error
        assert error.startswith(f"fourd {words[0]}: {url}: expected ")
        return error

    assert "got 'The specified bucket does not exist'; check the bucket" in refusal("s3://no-such-bucket/a")
    assert "got nothing; check the bucket and name" in refusal(f"{bucket.url}/nothing")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "")
    sys.modules["s3fs"].S3FileSystem.clear_instance_cache()
    assert "credentials" in refusal(f"{bucket.url}/a")
    monkeypatch.setitem(sys.modules, "s3fs", None)
    assert "expected the package s3fs, got none; install it: pip install 'fourd[storage]'" in refusal("s3://bucket/a")
    monkeypatch.setitem(sys.modules, "fsspec", None)
    assert "expected the package s3fs, got none; install it: pip install 'fourd[storage]'" in refusal("s3://bucket/a")
    assert "pip install 'fourd[storage]' gcsfs" in refusal("gs://bucket/a")


@pytest.mark.slow
def test_a_cluster_reads_and_writes_a_bucket(
    bucket: Bucket, small_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a fetch stage that cannot be sent to a node, or that runs without the credentials."""
    pytest.importorskip("ray", reason="needs ray (pip install 'fourd[cluster]')")
    monkeypatch.chdir(tmp_path)
    put_folder(bucket.files, small_capture, f"{bucket.name}/ball")
    (tmp_path / "small.yaml").write_text(OVERLAY)
    words = ["make", f"{bucket.url}/ball", "-o", f"{bucket.url}/ball.4dv", "--config", "small.yaml", "--max-steps", 2]
    assert run(*words, "--ray", "auto") == 0
    assert SceneReader(f"{bucket.url}/ball.4dv").manifest.frame_count == 2
