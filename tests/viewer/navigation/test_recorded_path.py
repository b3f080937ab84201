"""Recorded camera paths and remembered views, and what broken files do to them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.errors import UserError
from fourd.viewer.navigation import saved_views as remembered
from fourd.viewer.navigation.pose import Pose, pose_facing
from fourd.viewer.navigation.recorded_path import (
    RECORDED_FPS,
    PathRecorder,
    PathSample,
    RecordedPath,
    load_recorded_path,
)
from fourd.viewer.navigation.saved_views import SavedViews, pose_from_json, pose_to_json

Content = dict[str, Any]


def viewer(seed: int, across: float = 0.0) -> Pose:
    """A random place; ``across`` becomes the pivot's x."""
    rng = np.random.default_rng(seed)
    up = np.array([0.6, 0.0, 0.8])
    pose = pose_facing(rng.uniform(2, 3, 3), np.array([across, *rng.normal(size=2)]), up, rng.uniform(0.3, 1.2))
    return Pose(pose.pivot, pose.rotation, pose.distance, pose.field_of_view, up, (rng.normal(), 0.25))


def assert_same(got: Pose | None, expected: Pose) -> None:
    assert got is not None
    assert pose_to_json(got) == pose_to_json(expected)
    for name in ("pivot", "rotation", "up"):
        assert getattr(got, name).dtype == np.float64
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    assert got.offset == expected.offset
    assert (got.distance, got.field_of_view) == (expected.distance, expected.field_of_view)


def first_stop(**changes: Any) -> Callable[[Content], None]:
    """A change of a file's first stop; None takes a key away."""

    def change(content: Content) -> None:
        stop = content["stops"][0]
        for key, value in changes.items():
            stop.pop(key) if value is None else stop.update({key: value})

    return change


def test_a_flight_comes_back_as_it_was_saved(tmp_path: Path) -> None:
    """Catches rounded numbers, frames and poses out of step, and a pace that is lost."""
    flight = RecordedPath(tuple(PathSample(viewer(seed), 7 * seed % 5) for seed in range(20)), fps=24.5)
    flight.save(tmp_path / "new folder" / "a.path.json")
    again = load_recorded_path(tmp_path / "new folder" / "a.path.json")
    assert again.fps == 24.5
    assert len(again.samples) == 20
    for got, expected in zip(again.samples, flight.samples, strict=True):
        assert got.frame == expected.frame
        assert_same(got.pose, expected.pose)
    assert len(list((tmp_path / "new folder").iterdir())) == 1


@pytest.mark.parametrize("ticks", ["fast", "even", "slow", "uneven"])
def test_a_recording_has_an_even_pace(ticks: str) -> None:
    """Catches a flight that plays too fast or too slow where pictures came at another pace, or unevenly."""
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
        recorder.advance(step, viewer(0, across=time), number)
    stops = recorder.path().samples
    assert recorder.path().fps == RECORDED_FPS == 30
    assert recorder.seconds == pytest.approx(time)
    assert abs(len(stops) - 30 * time) <= 1
    late = np.array([stop.pose.pivot[0] for stop in stops]) - np.arange(len(stops)) / 30
    assert late.min() > -1e-9
    assert late.max() < max(steps) + 1e-9
    assert all(stop.pose.pivot[0] == pytest.approx(sum(steps[: stop.frame + 1])) for stop in stops)


def test_nothing_recorded_is_nothing() -> None:
    """Catches a stop at the moment in which the button is pressed, before any time has passed."""
    recorder = PathRecorder()
    assert recorder.path().samples == ()
    recorder.advance(0.0, viewer(0), 0)
    assert recorder.path().samples == ()
    recorder.advance(1e-6, viewer(0), 0)
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
    "a number as stop": lambda content: content["stops"].append(4),
    "fps missing": lambda content: content.pop("fps"),
    "fps 0": lambda content: content.update(fps=0),
    "fps negative": lambda content: content.update(fps=-30),
    "fps NaN": lambda content: content.update(fps=float("nan")),
    "fps infinite": lambda content: content.update(fps=float("inf")),
    "fps text": lambda content: content.update(fps="fast"),
    "fps huge": lambda content: content.update(fps=10**400),
    "frame missing": first_stop(frame=None),
    "frame text": first_stop(frame="first"),
    "frame NaN": first_stop(frame=float("nan")),
    "frame infinite": first_stop(frame=float("inf")),
    "frame a list": first_stop(frame=[1]),
    "pivot missing": first_stop(pivot=None),
    "pivot NaN": first_stop(pivot=[0, float("nan"), 0]),
    "pivot of two": first_stop(pivot=[0, 1]),
    "pivot ragged": first_stop(pivot=[0, [1], 2]),
    "pivot by name": first_stop(pivot={"x": 1}),
    "distance 0": first_stop(distance=0),
    "distance infinite": first_stop(distance=float("inf")),
    "distance huge": first_stop(distance=10**400),
    "rotation that is none": first_stop(rotation=[[1, 0, 0], [0, 2, 0], [0, 0, 1]]),
    "rotation mirrored": first_stop(rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
    "rotation flat": first_stop(rotation=[1, 0, 0, 0, 1, 0, 0, 0, 1]),
    "field of view 0": first_stop(field_of_view=0.0),
    "field of view in degrees": first_stop(field_of_view=50),
    "up of no length": first_stop(up=[0, 0, 0]),
    "offset missing": first_stop(offset=None),
    "offset of three": first_stop(offset=[0, 0, 0]),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_spoilt_flight_is_told_in_one_line(tmp_path: Path, name: str) -> None:
    """Catches a traceback, a hang or a broken picture from a file that somebody has edited."""
    path = tmp_path / "a.path.json"
    RecordedPath((PathSample(viewer(1), 0), PathSample(viewer(2), 1))).save(path)
    content = json.loads(path.read_text())
    CHANGES[name](content)
    path.write_text(json.dumps(content))
    assert_refused(path)


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"\xff\xfe\x00", b"null", b"[]", b"3", b'"fourd-path"', b"[" * 100_000, b"PK\x03\x04"],
    ids=["empty", "cut short", "bytes", "null", "list", "number", "text", "nested", "zip"],
)
def test_another_file_is_told_in_one_line(tmp_path: Path, content: bytes) -> None:
    """Catches a traceback where --path names a file of another kind."""
    path = tmp_path / "a.path.json"
    path.write_bytes(content)
    assert_refused(path)


def test_no_file_and_a_folder_are_told_in_one_line(tmp_path: Path) -> None:
    """Catches the operating system's error where a name is mistyped."""
    assert_refused(tmp_path)
    assert_refused(tmp_path / "nothing.path.json")


def assert_refused(path: Path) -> None:
    with pytest.raises(UserError) as raised:
        load_recorded_path(path)
    message = str(raised.value)
    assert message.startswith(f"{path}: expected ")
    assert "\n" not in message


def test_a_pose_from_a_file_is_checked() -> None:
    """Catches a view that was never one, and an error of another kind than the one that is promised."""
    for content in (None, 3, [], {}, "pose", {**pose_to_json(viewer(0)), "up": "z"}):
        with pytest.raises(ValueError, match=r"expected|could not convert"):
            pose_from_json(content)


def test_a_view_is_remembered_by_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches views of one scene shown in another, old ones that stay, and names that depend on the folder."""
    views = SavedViews(tmp_path / "state" / "fourd" / "views.json")
    one, other = tmp_path / "one.4dv", tmp_path / "other.4dv"
    assert views.load(one) is None
    views.save(one, viewer(1))
    views.save(other, viewer(2))
    views.save(one, viewer(3))
    monkeypatch.chdir(tmp_path)
    for memory in (views, SavedViews(tmp_path / "state" / "fourd" / "views.json")):
        assert_same(memory.load(one), viewer(3))
        assert_same(memory.load(Path("other.4dv")), viewer(2))
        assert memory.load(tmp_path / "third.4dv") is None


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"\xff\xfe\x00", b"null", b"[]", b"3", b"[" * 100_000],
    ids=["empty", "cut short", "bytes", "null", "list", "number", "nested"],
)
def test_a_broken_file_costs_the_memory_alone(tmp_path: Path, content: bytes) -> None:
    """Catches a viewer that does not start, or never remembers again, because of a broken file of its own."""
    file, scene = tmp_path / "views.json", tmp_path / "scene.4dv"
    file.write_bytes(content)
    views = SavedViews(file)
    assert views.load(scene) is None
    views.save(scene, viewer(1))
    assert_same(views.load(scene), viewer(1))


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
def test_a_broken_view_is_none_and_the_others_stay(tmp_path: Path, change: Content) -> None:
    """Catches one bad entry that takes the other scenes' views with it, or that is shown."""
    file = tmp_path / "views.json"
    views = SavedViews(file)
    for seed, name in enumerate(("bad.4dv", "good.4dv")):
        views.save(tmp_path / name, viewer(seed))
    content = json.loads(file.read_text())
    content[str((tmp_path / "bad.4dv").resolve())].update(change)
    file.write_text(json.dumps(content))
    assert views.load(tmp_path / "bad.4dv") is None
    assert_same(views.load(tmp_path / "good.4dv"), viewer(1))


def test_a_place_that_cannot_be_written_costs_the_memory_alone(tmp_path: Path) -> None:
    """Catches a viewer that fails as it closes, in a home without room for its state."""
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.json").mkdir()
    for place in (tmp_path / "file" / "views.json", tmp_path / "folder.json"):
        views = SavedViews(place)
        views.save(tmp_path / "scene.4dv", viewer(1))
        assert views.load(tmp_path / "scene.4dv") is None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.json"]


def test_the_scenes_seen_longest_ago_are_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a file that grows for ever, and a scene forgotten although it was seen just now."""
    monkeypatch.setattr(remembered, "_MAX_SCENES", 3)
    views = SavedViews(tmp_path / "views.json")
    for name in ("a", "b", "c", "a", "d"):
        views.save(tmp_path / name, viewer(0))
    assert [name for name in "abcd" if views.load(tmp_path / name) is not None] == ["a", "c", "d"]
