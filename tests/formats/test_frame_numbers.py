"""Order of files: every list of files has the order 1, 2, 10, whether or not the numbers have leading zeros."""

from __future__ import annotations

import random
import re
from pathlib import Path

import numpy as np
import pytest

from fourd.base.files import list_folder, sort_names
from fourd.base.formats.ply import write_ply
from fourd.recording.capture.layout import camera_folders, find_pictures, find_videos, sort_frames
from fourd.recording.capture.pictures.listing import list_images, list_masks
from fourd.recording.importing.folders import find_frames, list_entries, picture_files
from fourd.scene.meshes.source import MeshSource
from fourd.scene.splats.reader import SplatReader

ROOT = Path(__file__).parents[2]
NUMBERS = (1, 2, 3, 10, 11, 20, 100)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Files and folders that are created in random order."""
    numbers = list(NUMBERS)
    random.Random(0).shuffle(numbers)
    for number in numbers:
        for camera in (1, 2, 10):
            (tmp_path / "images" / f"cam{camera}").mkdir(parents=True, exist_ok=True)
            (tmp_path / "images" / f"cam{camera}" / f"frame_{number}.png").touch()
        (tmp_path / "videos").mkdir(exist_ok=True)
        (tmp_path / "videos" / f"cam{number}.mp4").touch()
    return tmp_path


def test_names_are_compared_by_value() -> None:
    """Catches the order 1, 10, 2, and names with different words that cannot be compared."""
    names = ["b1", "a", "a10", "a2", "a02", "a2b", "1", "", "a2b3", "a2b10"]
    for seed in range(20):
        random.Random(seed).shuffle(names)
        assert sort_names(names) == ["", "1", "a", "a02", "a2", "a2b", "a2b3", "a2b10", "a10", "b1"]


def test_every_list_of_files_is_in_natural_order(folder: Path) -> None:
    """Catches a function that lists files alphabetically."""
    images, frames = folder / "images", [f"frame_{number}" for number in NUMBERS]
    cameras = ["cam1", "cam2", "cam10"]
    assert camera_folders(images) == list_folder(images) == list_entries(images) == cameras
    assert list(find_pictures(images / "cam1")) == list(list_masks(images / "cam1", frames)) == frames
    assert list(list_images(images, cameras)["cam10"]) == sort_frames(reversed(frames)) == frames
    assert list(find_videos(folder / "videos")) == [f"cam{number}" for number in NUMBERS]
    assert list(find_frames(folder, ("images",))) == cameras
    found = picture_files(images / "cam2")
    assert found is not None
    assert list(found.names) == frames


def test_splats_and_meshes_are_in_natural_order(tmp_path: Path) -> None:
    """Catches a sequence of another program that plays in the order 1, 10, 2."""
    for number in NUMBERS:
        xyz = np.full((3, 3), number, np.float32) + np.eye(3, dtype=np.float32)
        write_ply(tmp_path / f"frame_{number}_points.ply", xyz, np.zeros((3, 3), np.uint8))
    reader = SplatReader(tmp_path)
    assert reader.manifest.frame_numbers == NUMBERS
    assert [round(float(reader.read(index).xyz.min())) for index in range(len(NUMBERS))] == list(NUMBERS)
    assert MeshSource(tmp_path).frame_numbers == NUMBERS


def test_no_other_function_sorts_files() -> None:
    """Catches a new alphabetical list of files. The weights of LPIPS are no sequence."""
    pattern = re.compile(r"sorted\([^()]*(os\.listdir|iterdir|scandir)\(")
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for name in ("fourd", "viewer")
        for path in (ROOT / name).rglob("*.py")
        for line in path.read_text().splitlines()
        if pattern.search(line) and path.name != "lpips.py"
    ]
    assert not found, "use fourd.base.files.list_folder instead"
