"""Finding the capture of a scene, and reading its pictures."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.viewer.comparison.captured import CapturedPicture, CapturedPictures, find_capture, require_capture
from tests.baking.scenes import manifest
from tests.viewer.comparison.captures import RED, write_flat_capture


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    return write_flat_capture(tmp_path / "recording", manifest(6, 3))


def until(found: Callable[[], object]) -> None:
    end = time.monotonic() + 30
    while not found():
        assert time.monotonic() < end
        time.sleep(0.005)


def read(pictures: CapturedPictures, camera: int, frame: int) -> CapturedPicture | None:
    pictures.get(camera, frame)
    until(lambda: not pictures.is_reading)
    return pictures.get(camera, frame)


def test_the_capture_of_a_run_or_of_a_scene_is_found(capture: Path, tmp_path: Path) -> None:
    """Catches a comparison that needs the name of a capture that fourd has stored, and one that fails for a damaged
    config or after the folder with the intermediate results was moved."""
    scene, run = tmp_path / "scene.4dv", tmp_path / "scene.work" / "run"
    assert find_capture(scene) is None
    run.mkdir(parents=True)
    for content in (f"capture: {tmp_path / 'gone'}", "capture: [", "- capture"):
        (run / "config.yaml").write_text(content)
        assert find_capture(scene) is None
    write_flat_capture(run.parent / "capture", manifest(6, 3), cameras=1)
    assert find_capture(scene) == run.parent / "capture"
    (run / "config.yaml").write_text(f"capture: {capture}\nscene: {{}}")
    assert find_capture(scene) == capture
    assert find_capture(run) == capture
    assert find_capture(capture / "made_here.4dv") == capture


def test_pictures_are_those_of_the_camera_and_the_frame(capture: Path) -> None:
    """Catches a picture of another frame, because the frames of a scene need not begin with the capture's first."""
    pictures = CapturedPictures(capture, manifest(6, 3))
    for frame in (0, 2):
        found = read(pictures, 0, frame)
        assert found is not None
        assert tuple(found.pixels[5, 5]) == (*RED[:2], 10 + frame)
    found = read(pictures, 1, 1)
    assert found is not None
    assert tuple(found.pixels[5, 5]) == (10, 10, 11)
    pictures.close()


def test_missing_pictures_are_reported_once(capture: Path) -> None:
    """Catches a comparison that waits forever for a picture, or that repeats its message in each image."""
    pictures = CapturedPictures(capture, manifest(6, 5))
    assert read(pictures, 3, 0) is None
    assert "recording: expected pictures of camera 03, got none" in pictures.take_error()
    assert pictures.take_error() == ""
    assert read(pictures, 0, 4) is None
    assert "expected frame 14 of the scene, got 13 frames" in pictures.take_error()
    assert read(pictures, 0, 1) is not None
    pictures.close()


def test_a_folder_that_is_no_capture_is_refused(capture: Path, tmp_path: Path) -> None:
    """Catches a wrong --capture that is noticed only when the key V is pressed."""
    assert require_capture(capture) == capture
    with pytest.raises(UserError, match=r"--capture .*: expected a capture \(images/ or videos/"):
        require_capture(tmp_path)
