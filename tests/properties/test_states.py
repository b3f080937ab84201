"""Checkpoints and the JSON files of stages. They must be read back unchanged, or be rejected with one error."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from fourd.base.errors import UserError
from fourd.pipeline.stages.cameras.repair import RESULT, repaired_capture
from fourd.pipeline.stages.mesh import SCORES_NAME, read_scores
from fourd.reconstruction.carving.sequence import BOUNDS_NAME, read_bounds
from fourd.reconstruction.training.checkpoints import SavedProgress, load_checkpoint, save_checkpoint, verify_checkpoint
from fourd.recording.boards import read_board
from fourd.recording.capture import frame_rate, video_list
from fourd.recording.importing.record import RECORD, check_unpacked, read_record, write_record
from fourd.viewer.camera_paths.keys import KeyedPath
from fourd.viewer.camera_paths.path import CameraPath
from fourd.viewer.camera_paths.reading import read_own_path, read_path
from fourd.viewer.camera_paths.world import read_world
from tests.properties.effort import EFFORTS
from tests.properties.json_trees import Tree, changed_trees, trees
from tests.viewer.camera_paths.exports import SCENE, camera_to_world, cameras, viewer_export

DTYPES = (torch.float32, torch.float64, torch.float16, torch.int64, torch.uint8, torch.bool)


def tensors() -> st.SearchStrategy[Tensor]:
    """Small tensors with random bits."""
    return st.tuples(st.integers(0, 1 << 32), st.lists(st.integers(0, 3), max_size=3), st.sampled_from(DTYPES)).map(
        lambda each: _random_bits(*each)
    )


def _random_bits(seed: int, shape: list[int], dtype: torch.dtype) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    if dtype == torch.bool:
        return torch.randint(0, 2, shape, generator=generator, dtype=torch.uint8).bool()
    width = torch.empty(0, dtype=dtype).element_size()
    return torch.randint(0, 256, (*shape, width), generator=generator, dtype=torch.uint8).view(dtype).reshape(shape)


@EFFORTS
def test_checkpoints_are_read_back_equal(effort: settings, tmp_path: Path) -> None:
    """Catches tensors, numbers and texts that change when a checkpoint is written and read."""
    named = st.dictionaries(st.text(min_size=1, max_size=8).filter(lambda name: name != "__metadata__"), tensors())
    states = st.dictionaries(st.text(), trees(), max_size=4)

    @effort
    @given(st.integers(0, 10**9), named, states)
    def check(step: int, given_tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        path = save_checkpoint(tmp_path / "a", step, given_tensors, state)
        found_step, found_tensors, found_state = load_checkpoint(path)
        assert (found_step, found_state) == (step, state)
        assert found_tensors.keys() == given_tensors.keys()
        for name, tensor in given_tensors.items():
            found = found_tensors[name]
            assert (found.dtype, found.shape) == (tensor.dtype, tensor.shape)
            assert found.numpy().tobytes() == tensor.numpy().tobytes()
        assert verify_checkpoint(path) == 1
        shutil.rmtree(tmp_path / "a")

    check()


@EFFORTS
def test_damaged_checkpoints_are_refused(effort: settings, tmp_path: Path) -> None:
    """Catches a damaged checkpoint that is read without an error, and exceptions other than UserError."""
    given_tensors = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.tensor([True])}
    state = {"seconds": 1.5, "psnr": 20.25}
    path = save_checkpoint(tmp_path, 7, given_tensors, state)
    whole = path.read_bytes()
    before = (7, state, [tensor.tolist() for tensor in given_tensors.values()])
    places = st.integers(0, len(whole) - 1)

    @effort
    @given(places, st.binary(max_size=3), st.integers(0, 3))
    def check(at: int, piece: bytes, removed: int) -> None:
        path.write_bytes(whole[:at] + piece + whole[at + removed :])
        try:
            step, found, found_state = load_checkpoint(path)
        except UserError as error:
            assert path.name in str(error)  # noqa: PT017
            return
        assert (step, found_state, [tensor.tolist() for tensor in found.values()]) == before

    check()


@EFFORTS
def test_progress_of_any_state_is_read_or_refused(effort: settings) -> None:
    """Catches a traceback in training for a checkpoint whose digests are correct but whose state is invalid."""

    @effort
    @given(changed_trees({"seconds": 1.5, "psnr": 20.25}) | trees())
    def check(state: Tree) -> None:
        try:
            progress = SavedProgress.from_json(state, "a.safetensors")
        except UserError as error:
            assert str(error).startswith("a.safetensors")  # noqa: PT017
            return
        assert SavedProgress.from_json(json.loads(json.dumps(progress.to_json())), "a") == progress

    check()


INDEX = {
    "frames": 20, "width": 64, "height": 48, "start": "0", "fps": "30000/1001", "tick": "1/30000", "keyframes": [0, 10],
    "times": list(range(0, 20020, 1001)), "turn": 0,
}  # fmt: skip
VIDEOS = {"version": 3, "fps": "25", "cameras": {"00": {"file": "00.mp4", "bytes": 100, "offset": 0.5, "index": INDEX}}}
IMPORTED = {
    "version": 1, "source": "a", "format": "easymocap", "calibration": "1", "files": "2", "options": {"reduce": 1},
    "offsets": {"00": 1.5}, "unpacked": True, "done": True, "warnings": ["a"],
}  # fmt: skip
BOX = {"lower": [0, 0, 0], "upper": [1, 1, 1]}
POSE = {
    "frame": 3, "pivot": [0, 0, 1], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "distance": 2.0,
    "field_of_view": 0.9, "up": [0, 0, 1], "offset": [0, 0],
}  # fmt: skip


KEYS = [{**POSE, "seconds": 0.5, "easing": "stop"}, {**POSE, "seconds": 2, "pivot": [3, 1, 2], "easing": "smooth"}]
NERFSTUDIO = viewer_export([camera_to_world(camera) for camera in cameras(2)], [0.0, 1.0])
POSES = {
    "w": 32, "h": 24, "fl_x": 30.0,
    "frames": [{"file_path": "a.png", "transform_matrix": camera_to_world(cameras(2)[0]).tolist(), "time": 0.5}],
}  # fmt: skip
WORLD = [[1.0, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0]]


def _read_import(folder: Path) -> None:
    record = read_record(folder)
    if record is not None:
        check_unpacked(folder, record, "2", {"00": 1.5}, 1.0)
        write_record(folder, record)
        assert read_record(folder) == record


def _list_videos(folder: Path) -> None:
    (folder / "videos").mkdir(exist_ok=True)
    (folder / "videos" / "00.mp4").write_bytes(bytes(100))
    video_list.list_videos(folder)


def _sample_keys(folder: Path) -> None:
    path = read_own_path(folder / "a.json")
    if isinstance(path, KeyedPath):
        for sample in path.at(np.linspace(0, path.duration, 7)):
            sample.pose.camera(16, 16)


def _sample(path: CameraPath) -> None:
    for sample in path.with_count(3).samples:
        sample.pose.camera(16, 16)


READERS: dict[str, tuple[str, Tree, Callable[[Path], object]]] = {
    "frame rate": (frame_rate.NAME, {"version": 1, "fps": "30000/1001"}, frame_rate.read_rate),
    "clock": (video_list.NAME, VIDEOS, lambda folder: video_list.read_clock(folder / video_list.NAME)),
    "videos": (video_list.NAME, VIDEOS, _list_videos),
    "import": (str(RECORD), IMPORTED, _read_import),
    "bounds": (BOUNDS_NAME, {"version": 1, "key": "a", "search": BOX, **BOX}, read_bounds),
    "scores": (SCORES_NAME, {"mean": {"iou": 0.5, "psnr": 20.5}, "pictures": []}, read_scores),
    "repair": (RESULT, {"changed": True}, lambda folder: repaired_capture(folder, folder)),
    "camera path": (
        "a.json",
        {"format": "fourd-path", "version": 1, "fps": 30.0, "stops": [POSE]},
        lambda folder: read_own_path(folder / "a.json"),
    ),
    "key frames": ("a.json", {"format": "fourd-path", "version": 2, "fps": 30.0, "keys": KEYS}, _sample_keys),
    "nerfstudio's path": ("a.json", NERFSTUDIO, lambda folder: _sample(read_path(folder / "a.json", SCENE))),
    "poses": ("transforms.json", POSES, lambda folder: _sample(read_path(folder / "transforms.json", SCENE))),
    "world": ("a.json", {"transform": WORLD, "scale": 0.5}, lambda folder: read_world([folder / "a.json"])),
}
"""File name, valid content, and a function that reads the file in a folder."""


@EFFORTS
@pytest.mark.parametrize("name", READERS)
def test_changed_state_files_are_read_or_refused(name: str, effort: settings, tmp_path: Path) -> None:
    """Catches exceptions other than UserError for files of a capture, of an import and of a stage."""
    file, valid, read = READERS[name]
    path = tmp_path / file
    path.parent.mkdir(exist_ok=True)

    @effort
    @given(changed_trees(valid).map(json.dumps) | trees().map(json.dumps) | st.text(st.characters(codec="utf-8")))
    def check(text: str) -> None:
        path.write_text(text, encoding="utf-8")
        try:
            read(tmp_path)
        except UserError as error:
            assert path.name in str(error) or str(tmp_path) in str(error)  # noqa: PT017

    check()


@pytest.mark.parametrize("name", READERS)
def test_valid_state_files_are_read(name: str, tmp_path: Path) -> None:
    """Catches a property test that passes only because valid content is rejected."""
    file, valid, read = READERS[name]
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(json.dumps(valid))
    read(tmp_path)


BOARD = [
    'pattern = "charuco"',
    "columns = 8",
    "rows = 6",
    "square_m = 0.03",
    "marker_m = 0.02",
    'dictionary = "4X4_50"',
]
VALUES = (
    "1e400",
    "nan",
    "-1",
    "9" * 5000,
    "true",
    '""',
    "[1]",
    "{a = 1}",
    "1979-05-27",
    "0x7fffffffffffffff",
    "'\\x00'",
)


@EFFORTS
def test_changed_boards_are_read_or_refused(effort: settings, tmp_path: Path) -> None:
    """Catches exceptions other than UserError for the TOML file of a calibration board."""
    path = tmp_path / "board.toml"

    @effort
    @given(st.integers(0, len(BOARD) - 1), st.sampled_from(VALUES) | st.text(max_size=8), st.booleans())
    def check(line: int, value: str, is_added: bool) -> None:
        lines = list(BOARD)
        lines[line] = f"{lines[line].split(' = ')[0]} = {value}"
        path.write_text("\n".join(lines + [value] * is_added), encoding="utf-8", errors="replace")
        try:
            read_board(path)
        except UserError as error:
            assert path.name in str(error)  # noqa: PT017

    check()
