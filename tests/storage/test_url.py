"""Tests of URLs: the accepted forms, and commands that must not use a URL as the name of a local folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.base.storage import StorageUrl, check_writable, open_object, parse_location
from fourd.cli.main import main
from fourd.scene import SceneWriter
from tests.baking.scenes import manifest


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("s3://bucket/a/scene.4dv", StorageUrl("s3://bucket/a/scene.4dv")),
        ("S3://bucket/videos/", StorageUrl("s3://bucket/videos")),
        ("gs://bucket/100%/a b", StorageUrl("gs://bucket/100%/a b")),
        ("s3://bucket", StorageUrl("s3://bucket")),
        ("file:///data/scene.4dv", Path("/data/scene.4dv")),
        ("videos", Path("videos")),
        ("C:/videos", Path("C:/videos")),
        ("s3:/bucket", Path("s3:/bucket")),
    ],
)
def test_urls_and_paths_are_told_apart(text: str, expected: Path | StorageUrl) -> None:
    """Catches a Windows drive that is read as a scheme, and percent-decoding of a name."""
    assert parse_location(text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("https://host/scene.4dv", "https://host/scene.4dv: expected a local path, or a URL that starts with s3://"),
        ("file://host/scene.4dv", "file://host/scene.4dv: expected an absolute path after file://, got 'host/scene"),
        ("s3://", "s3://: expected s3://BUCKET/NAME, got another form; write the bucket and the name"),
        ("s3://bucket//a", "s3://bucket//a: expected s3://BUCKET/NAME"),
        ("s3://bucket/../other/a", "s3://bucket/../other/a: expected s3://BUCKET/NAME"),
        ("s3://bucket/a\n", "expected s3://BUCKET/NAME"),
    ],
)
def test_other_urls_are_refused(text: str, message: str) -> None:
    """Catches a URL of an unknown store that is used as a local path."""
    with pytest.raises(UserError) as caught:
        parse_location(text)
    assert message in str(caught.value)


def test_a_bucket_is_no_object() -> None:
    """Catches a traceback if a URL has no name after the bucket."""
    pytest.importorskip("s3fs", reason="needs s3fs (pip install 'fourd[storage]')")
    for use in (check_writable, open_object):
        with pytest.raises(UserError) as caught:
            use(StorageUrl("s3://bucket"))
        assert str(caught.value) == (
            "s3://bucket: expected the name of an object in the bucket, got only a bucket; write s3://bucket/NAME"
        )


def test_the_library_writes_scenes_to_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a scene in the local folder "s3:" """
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError) as caught:
        SceneWriter("s3://bucket/scene.4dv", manifest())
    assert str(caught.value) == (
        "s3://bucket/scene.4dv: expected a local path to write a scene, got a URL; use a path of this machine"
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [
        ["carve", "s3://bucket/capture", "-o", "hulls"],
        ["train", "capture", "-o", "s3://bucket/run"],
        ["train", "capture", "-o", "run", "--config", "s3://bucket/small.yaml"],
        ["make", "videos", "-o", "scene.4dv", "--calibration=s3://bucket/calibration"],
        ["render", "scene.4dv", "--path", "orbit", "-o", "s3://bucket/orbit.mp4"],
        ["eval", "s3://bucket/run"],
        ["import", "s3://bucket/videos", "capture"],
        ["export", "scene.4dv", "--to", "spz", "-o", "s3://bucket/points"],
        ["matte", "s3://bucket/capture"],
        ["mesh", "capture", "-o", "s3://bucket/meshes"],
        ["web", "s3://bucket/scene.4dv", "-o", "site"],
        ["serve", "s3://bucket/run"],
        ["calibrate", "s3://bucket/boards", "--board", "board.toml", "-o", "calibration"],
        ["synth", "s3://bucket/capture"],
        ["train", "capture", "-o", "run", "--max-steps", "1", "--background", "s3://bucket/points.ply"],
    ],
)
def test_arguments_without_storage_refuse_urls(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a command that creates or looks for the local folder "s3:"."""
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    error = capsys.readouterr().err
    url = next(word for word in words if "s3://" in word).partition("=")[2] or next(w for w in words if "s3://" in w)
    assert error.startswith(f"fourd {words[0]}: {url}: expected a local path")
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
