"""Videos, or folders of pictures, of which nothing is known."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.importing.formats.detection import FORMATS
from fourd.importing.formats.videos import looks_like, read
from tests.importing.formats.sources import assert_told, detected, file_names, write_pictures, write_video


def test_videos_have_no_lens(tmp_path: Path) -> None:
    for name in ("b.MP4", "a.mp4"):
        write_video(tmp_path / "videos" / name)
    assert detected(tmp_path) == "videos"
    cameras = read(tmp_path).cameras
    assert [(camera.name, camera.lens) for camera in cameras] == [("a", None), ("b", None)]
    assert file_names(cameras[1].frames) == ["b.MP4"]


@pytest.mark.parametrize("place", [".", "images"])
def test_folders_of_pictures(tmp_path: Path, place: str) -> None:
    """Catches images/, which holds the cameras' folders, being taken for a camera."""
    for name in ("left", "right"):
        write_pictures(tmp_path / place / name, ["9.jpg", "11.jpg"])
    cameras = read(tmp_path).cameras
    assert [camera.name for camera in cameras] == ["left", "right"]
    assert file_names(cameras[0].frames) == ["9.jpg", "11.jpg"]


def test_what_is_no_source(tmp_path: Path) -> None:
    assert_told(read, tmp_path, r"expected a video or a folder of pictures for each camera")
    file = tmp_path / "notes.txt"
    file.write_text("none")
    for path in (tmp_path, tmp_path / "none", file):
        assert detected(path) is None
        assert not looks_like(path)
    assert not any(form.looks_like(tmp_path / ("x" * 300)) for form in FORMATS if form.name != "qualisys")


def test_twins_are_told(tmp_path: Path) -> None:
    for name in ("a.mp4", "a.mov"):
        write_video(tmp_path / name)
    assert_told(read, tmp_path, r"a.mp4: expected each camera once, got a.mov of the same name; rename one of them")
