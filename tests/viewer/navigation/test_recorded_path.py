"""Recorded camera paths and saved views, and damaged files of both."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.json_file import decode_json
from fourd.viewer.camera_paths.reading import read_own_path
from fourd.viewer.navigation import saved_views
from fourd.viewer.navigation.pose import Pose, pose_facing
from fourd.viewer.navigation.recorded_path import (
    RECORDED_FPS,
    PathRecorder,
    PathSample,
    RecordedPath,
)
from fourd.viewer.navigation.saved_views import SavedViews, StoredPose, pose_to_json

Content = dict[str, Any]


def make_pose(seed: int, pivot_x: float = 0.0) -> Pose:
    """A random pose."""
    rng = np.random.default_rng(seed)
    up = np.array([0.6, 0.0, 0.8])
    pose = pose_facing(rng.uniform(2, 3, 3), np.array([pivot_x, *rng.normal(size=2)]), up, rng.uniform(0.3, 1.2))
    return Pose(pose.pivot, pose.rotation, pose.distance, pose.field_of_view, up, (rng.normal(), 0.25))


def assert_same(got: Pose | None, expected: Pose) -> None:
    assert got is not None
    assert pose_to_json(got) == pose_to_json(expected)
    for name in ("pivot", "rotation", "up"):
        assert getattr(got, name).dtype == np.float64
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    assert got.offset == expected.offset
    assert (got.distance, got.field_of_view) == (expected.distance, expected.field_of_view)


def change_first_sample(**changes: Any) -> Callable[[Content], None]:
    """Return a function that changes keys of the first sample in a path file. A value of None removes the key."""

    def change(content: Content) -> None:
        sample = content["stops"][0]
        for key, value in changes.items():
            sample.pop(key) if value is None else sample.update({key: value})

    return change


def test_a_recorded_path_survives_the_round_trip(tmp_path: Path) -> None:
    """Catches path files with rounded numbers, with frames at the wrong poses, or without the frame rate."""
    recorded = RecordedPath(tuple(PathSample(make_pose(seed), 7 * seed % 5) for seed in range(20)), fps=24.5)
    recorded.save(tmp_path / "new folder" / "a.path.json")
    loaded = read_own_path(tmp_path / "new folder" / "a.path.json")
    assert loaded.fps == 24.5
    assert len(loaded.samples) == 20
    for got, expected in zip(loaded.samples, recorded.samples, strict=True):
        assert got.frame == expected.frame
        assert_same(got.pose, expected.pose)
    assert len(list((tmp_path / "new folder").iterdir())) == 1


@pytest.mark.parametrize("ticks", ["fast", "even", "slow", "uneven"])
def test_recordings_have_a_constant_rate(ticks: str) -> None:
    """Catches a recorded path that plays too fast or too slow if images were drawn at another rate or a varying
    rate."""
    rng = np.random.default_rng(5)
    steps = {
        "fast": [1 / 240] * 720,
        "even": [1 / 30] * 90,
        "slow": [1 / 7] * 21,
        "uneven": list(rng.uniform(0, 0.1, 60)),
    }[ticks]
    recorder = PathRecorder()
    time = 0.0
    for number, step in enumerate(steps):
        time += step
        recorder.advance(step, make_pose(0, pivot_x=time), number)
    samples = recorder.path().samples
    assert recorder.path().fps == RECORDED_FPS == 30
    assert recorder.seconds == pytest.approx(time)
    assert abs(len(samples) - 30 * time) <= 1
    delays = np.array([sample.pose.pivot[0] for sample in samples]) - np.arange(len(samples)) / 30
    assert delays.min() > -1e-9
    assert delays.max() < max(steps) + 1e-9
    assert all(sample.pose.pivot[0] == pytest.approx(sum(steps[: sample.frame + 1])) for sample in samples)


def test_an_empty_recording_has_no_samples() -> None:
    """Catches a recording that has a sample before any time has passed."""
    recorder = PathRecorder()
    assert recorder.path().samples == ()
    recorder.advance(0.0, make_pose(0), 0)
    assert recorder.path().samples == ()
    recorder.advance(1e-6, make_pose(0), 0)
    assert len(recorder.path().samples) == 1


CHANGES: dict[str, Callable[[Content], Any]] = {
    "other format": lambda content: content.update(format="fourd-scene"),
    "no format": lambda content: content.pop("format"),
    "newer version": lambda content: content.update(version=2),
    "no version": lambda content: content.pop("version"),
    "no stops": lambda content: content.update(stops=[]),
    "stops missing": lambda content: content.pop("stops"),
    "stops null": lambda content: content.update(stops=None),
    "stops text": lambda content: content.update(stops="stop"),
    "stops by name": lambda content: content.update(stops={"first": content["stops"][0]}),
    "number as stop": lambda content: content["stops"].append(4),
    "fps missing": lambda content: content.pop("fps"),
    "fps 0": lambda content: content.update(fps=0),
    "fps negative": lambda content: content.update(fps=-30),
    "fps NaN": lambda content: content.update(fps=float("nan")),
    "fps infinite": lambda content: content.update(fps=float("inf")),
    "fps text": lambda content: content.update(fps="fast"),
    "fps huge": lambda content: content.update(fps=10**400),
    "frame missing": change_first_sample(frame=None),
    "frame text": change_first_sample(frame="first"),
    "frame NaN": change_first_sample(frame=float("nan")),
    "frame infinite": change_first_sample(frame=float("inf")),
    "frame a list": change_first_sample(frame=[1]),
    "pivot missing": change_first_sample(pivot=None),
    "pivot NaN": change_first_sample(pivot=[0, float("nan"), 0]),
    "pivot of two": change_first_sample(pivot=[0, 1]),
    "pivot ragged": change_first_sample(pivot=[0, [1], 2]),
    "pivot by name": change_first_sample(pivot={"x": 1}),
    "distance 0": change_first_sample(distance=0),
    "distance infinite": change_first_sample(distance=float("inf")),
    "distance huge": change_first_sample(distance=10**400),
    "rotation that scales": change_first_sample(rotation=[[1, 0, 0], [0, 2, 0], [0, 0, 1]]),
    "rotation mirrored": change_first_sample(rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
    "rotation flat": change_first_sample(rotation=[1, 0, 0, 0, 1, 0, 0, 0, 1]),
    "field of view 0": change_first_sample(field_of_view=0.0),
    "field of view in degrees": change_first_sample(field_of_view=50),
    "up of zero length": change_first_sample(up=[0, 0, 0]),
    "offset missing": change_first_sample(offset=None),
    "offset of three": change_first_sample(offset=[0, 0, 0]),
}


@pytest.mark.parametrize("name", CHANGES)
def test_an_invalid_path_file_raises_a_user_error(tmp_path: Path, name: str) -> None:
    """Catches an invalid path file that causes a traceback, a hang or a wrong image."""
    path = tmp_path / "a.path.json"
    RecordedPath((PathSample(make_pose(1), 0), PathSample(make_pose(2), 1))).save(path)
    content = json.loads(path.read_text())
    CHANGES[name](content)
    path.write_text(json.dumps(content))
    assert_rejected(path)


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"\xff\xfe\x00", b"null", b"[]", b"3", b'"fourd-path"', b"[" * 100_000, b"PK\x03\x04"],
    ids=["empty", "cut short", "bytes", "null", "list", "number", "text", "nested", "zip"],
)
def test_a_file_of_another_kind_raises_a_user_error(tmp_path: Path, content: bytes) -> None:
    """Catches a traceback if the option --path names a file of another kind."""
    path = tmp_path / "a.path.json"
    path.write_bytes(content)
    assert_rejected(path)


def test_a_missing_file_and_a_folder_raise_a_user_error(tmp_path: Path) -> None:
    """Catches a bare OSError if the name of a path file is misspelt."""
    assert_rejected(tmp_path)
    assert_rejected(tmp_path / "nothing.path.json")


def assert_rejected(path: Path) -> None:
    with pytest.raises(UserError) as raised:
        read_own_path(path)
    message = str(raised.value)
    assert message.startswith(f"{path}: expected ")
    assert "\n" not in message


def test_invalid_poses_raise_a_value_error() -> None:
    """Catches an invalid pose that is accepted, and an exception whose type differs from the documented type."""
    for content in (None, 3, [], {}, "pose", {**pose_to_json(make_pose(0)), "up": "z"}):
        with pytest.raises(ValueError, match="expected"):
            decode_json(content, StoredPose)


def test_views_are_saved_by_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a saved view of another scene, an old view that is not replaced, and views that depend on the working
    directory."""
    views = SavedViews(tmp_path / "state" / "fourd" / "views.json")
    one, other = tmp_path / "one.4dv", tmp_path / "other.4dv"
    assert views.load(one) is None
    views.save(one, make_pose(1))
    views.save(other, make_pose(2))
    views.save(one, make_pose(3))
    monkeypatch.chdir(tmp_path)
    for saved in (views, SavedViews(tmp_path / "state" / "fourd" / "views.json")):
        assert_same(saved.load(one), make_pose(3))
        assert_same(saved.load(Path("other.4dv")), make_pose(2))
        assert saved.load(tmp_path / "third.4dv") is None


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"\xff\xfe\x00", b"null", b"[]", b"3", b"[" * 100_000],
    ids=["empty", "cut short", "bytes", "null", "list", "number", "nested"],
)
def test_a_damaged_views_file_is_replaced(tmp_path: Path, content: bytes) -> None:
    """Catches a viewer that does not start, or does not save views, because its file of saved views is damaged."""
    file, scene = tmp_path / "views.json", tmp_path / "scene.4dv"
    file.write_bytes(content)
    views = SavedViews(file)
    assert views.load(scene) is None
    views.save(scene, make_pose(1))
    assert_same(views.load(scene), make_pose(1))


@pytest.mark.parametrize(
    "change",
    [
        {"distance": -1},
        {"distance": 10**400},
        {"distance": float("nan")},
        {"rotation": [[0] * 3] * 3},
        {"pivot": "here"},
        {"up": None},
    ],
    ids=["negative", "huge", "NaN", "no rotation", "text", "null"],
)
def test_an_invalid_view_is_ignored_and_the_others_stay(tmp_path: Path, change: Content) -> None:
    """Catches an invalid saved view that is used, or that removes the other saved views."""
    file = tmp_path / "views.json"
    views = SavedViews(file)
    for seed, name in enumerate(("bad.4dv", "good.4dv")):
        views.save(tmp_path / name, make_pose(seed))
    content = json.loads(file.read_text())
    content[str((tmp_path / "bad.4dv").resolve())].update(change)
    file.write_text(json.dumps(content))
    assert views.load(tmp_path / "bad.4dv") is None
    assert_same(views.load(tmp_path / "good.4dv"), make_pose(1))


def test_an_unwritable_views_file_is_ignored(tmp_path: Path) -> None:
    """Catches a viewer that fails on exit if its saved views cannot be written."""
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.json").mkdir()
    for path in (tmp_path / "file" / "views.json", tmp_path / "folder.json"):
        views = SavedViews(path)
        views.save(tmp_path / "scene.4dv", make_pose(1))
        assert views.load(tmp_path / "scene.4dv") is None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.json"]


def test_the_oldest_views_are_dropped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a file of saved views that grows without limit, and a recent view that is dropped."""
    monkeypatch.setattr(saved_views, "_MAX_SCENES", 3)
    views = SavedViews(tmp_path / "views.json")
    for name in ("a", "b", "c", "a", "d"):
        views.save(tmp_path / name, make_pose(0))
    assert [name for name in "abcd" if views.load(tmp_path / name) is not None] == ["a", "c", "d"]
