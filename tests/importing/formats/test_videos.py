"""Videos, or folders of images, without calibration."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.recording.importing.detection import FORMATS
from fourd.recording.importing.formats.videos import looks_like, read
from tests.importing.formats.sources import assert_refused, detect_format, file_names, write_pictures, write_video


def test_videos_have_no_calibration(tmp_path: Path) -> None:
    for name in ("b.MP4", "a.mp4"):
        write_video(tmp_path / "videos" / name)
    assert detect_format(tmp_path) == "videos"
    cameras = read(tmp_path).cameras
    assert [(camera.name, camera.calibration) for camera in cameras] == [("a", None), ("b", None)]
    assert file_names(cameras[1].frames) == ["b.MP4"]


@pytest.mark.parametrize("folder", [".", "images"])
def test_folders_of_pictures(tmp_path: Path, folder: str) -> None:
    """Catches a folder images/ that is read as a camera although it contains the cameras' folders."""
    for name in ("left", "right"):
        write_pictures(tmp_path / folder / name, ["9.jpg", "11.jpg"])
    cameras = read(tmp_path).cameras
    assert [camera.name for camera in cameras] == ["left", "right"]
    assert file_names(cameras[0].frames) == ["9.jpg", "11.jpg"]


def test_other_folders_are_refused(tmp_path: Path) -> None:
    assert_refused(read, tmp_path, r"expected a video or a folder of images for each camera")
    file = tmp_path / "notes.txt"
    file.write_text("none")
    for path in (tmp_path, tmp_path / "none", file):
        assert detect_format(path) is None
        assert not looks_like(path)
    assert not any(form.looks_like(tmp_path / ("x" * 300)) for form in FORMATS if form.name != "qualisys")


def test_videos_of_one_name_are_refused(tmp_path: Path) -> None:
    for name in ("a.mp4", "a.mov"):
        write_video(tmp_path / name)
    assert_refused(read, tmp_path, r"a.mp4: expected one video per camera, got a.mov for the same camera; rename one")
