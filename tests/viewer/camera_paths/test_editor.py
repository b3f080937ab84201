"""The camera path that the user makes in the window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.viewer.camera_paths.editor import MAX_STEP_S, PathEditor
from fourd.viewer.navigation.recorded_path import PathSample, RecordedPath
from tests.viewer.camera_paths.test_motion import around


def edited(count: int = 3) -> PathEditor:
    editor = PathEditor()
    for index, pose in enumerate(around(count, 8)):
        assert editor.add(pose, 2 * index) == f"key frame {index + 1} of the camera path"
    return editor


def test_the_path_plays_and_stops_at_its_end() -> None:
    """Catches a path that jumps back at its end, or that shows other frames than the key frames have."""
    editor = edited()
    poses = [key.pose for key in editor.keys]
    assert editor.advance(1.0) is None
    editor.toggle()
    assert editor.is_playing
    steps = [editor.advance(0.5) for _ in range(8)]
    assert [step.frame for step in steps if step is not None][3] == 2
    assert steps[3] is not None
    assert steps[3].pose is poses[1]
    assert steps[-1] is not None
    assert (steps[-1].pose, steps[-1].frame) == (poses[2], 4)
    assert not editor.is_playing
    assert editor.advance(0.5) is None
    editor.set_loop(True)
    editor.toggle()
    sample = editor.advance(6.0)
    assert sample is not None
    assert sample.pose is poses[0]
    assert editor.is_playing
    editor.toggle()
    assert not editor.is_playing


def test_times_and_easing_can_be_changed() -> None:
    """Catches a change that has no effect on the path that is played, and times that put key frames at one moment."""
    editor = edited()
    editor.change(1, step_s=0.5)
    editor.change(2, step_s=1e9, easing="stop")
    path = editor.path()
    assert path is not None
    assert [key.seconds for key in path.keys] == [0.0, 0.5, 0.5 + MAX_STEP_S]
    assert [key.easing for key in path.keys] == ["smooth", "smooth", "stop"]
    editor.remove(1)
    path = editor.path()
    assert path is not None
    assert [key.frame for key in path.keys] == [0.0, 4.0]
    editor.set_has_frames(False)
    recording = editor.recording(3, 15.0)
    assert recording is not None
    assert [sample.frame for sample in recording.samples[:8]] == [0, 0, 1, 1, 2, 2, 0, 0]
    assert PathEditor().recording(3, 15.0) is None
    assert PathEditor().path() is None


@pytest.mark.parametrize("is_loop", [False, True])
def test_a_saved_path_is_loaded(is_loop: bool, tmp_path: Path) -> None:
    """Catches key frames, times or the closing of the path that are lost in a file."""
    editor = edited()
    editor.set_loop(is_loop)
    editor.change(0, step_s=3.0)
    editor.change(1, step_s=0.25, easing="cut")
    editor.save(tmp_path / "a.path.json")
    loaded = PathEditor()
    loaded.load(tmp_path / "a.path.json")
    before, after = editor.path(), loaded.path()
    assert before is not None
    assert after is not None
    assert after.to_json() == before.to_json()
    assert loaded.is_loop == is_loop


def test_a_recorded_path_becomes_key_frames(tmp_path: Path) -> None:
    """Catches a recording of a minute that becomes two thousand key frames."""
    poses = around(100, 3)
    RecordedPath(tuple(PathSample(pose, index) for index, pose in enumerate(poses))).save(tmp_path / "a.path.json")
    editor = PathEditor()
    editor.load(tmp_path / "a.path.json")
    assert len(editor.keys) == 32
    path = editor.path()
    assert path is not None
    assert path.duration == pytest.approx(99 / 30)
    np.testing.assert_array_equal(path.keys[-1].pose.rotation, poses[-1].rotation)
    kept = editor.keys
    with pytest.raises(UserError, match="expected a camera path, got 'no such file or directory'"):
        editor.load(tmp_path / "none.json")
    assert editor.try_load(tmp_path / "none.json").startswith(f"{tmp_path / 'none.json'}: expected a camera path")
    assert editor.keys == kept
    assert editor.try_load(tmp_path / "a.path.json").endswith(": 32 key frames; press Y to play the path")
