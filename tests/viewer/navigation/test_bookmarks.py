"""Bookmarks: views of a scene that the user has kept."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fourd.viewer.navigation.bookmarks import MAX_BOOKMARKS, Bookmarks
from fourd.viewer.navigation.recorded_path import PathSample
from tests.viewer.navigation.test_recorded_path import assert_same, make_pose


def test_bookmarks_are_kept_by_scene(tmp_path: Path) -> None:
    """Catches bookmarks of another scene, ones that are lost when the window closes, and one that is removed instead of
    another."""
    one, other = tmp_path / "one.4dv", tmp_path / "other.4dv"
    bookmarks = Bookmarks(tmp_path / "bookmarks.json")
    bookmarks.open(one)
    for number in range(3):
        assert f"press {number + 1} to return" in bookmarks.add(PathSample(make_pose(number), 10 * number))
    bookmarks.remove(1)
    bookmarks.open(other)
    assert bookmarks.kept == ()
    again = Bookmarks(tmp_path / "bookmarks.json")
    again.open(one)
    assert [view.frame for view in again.kept] == [0, 20]
    assert_same(again.kept[1].pose, make_pose(2))


def test_there_are_as_many_bookmarks_as_keys(tmp_path: Path) -> None:
    """Catches a bookmark that no key reaches."""
    bookmarks = Bookmarks(tmp_path / "bookmarks.json")
    bookmarks.open(tmp_path / "one.4dv")
    for number in range(MAX_BOOKMARKS):
        bookmarks.add(PathSample(make_pose(number), number))
    assert "expected at most 9 bookmarks" in bookmarks.add(PathSample(make_pose(0), 0))
    assert len(bookmarks.kept) == 9


@pytest.mark.parametrize("value", [3, "x", [3], [{}], [{"frame": -1}], None])
def test_damaged_bookmarks_are_ignored(value: object, tmp_path: Path) -> None:
    """Catches a viewer that cannot open a scene, because the file of bookmarks is damaged."""
    scene = tmp_path / "one.4dv"
    (tmp_path / "bookmarks.json").write_text(json.dumps({str(scene.resolve()): value}))
    bookmarks = Bookmarks(tmp_path / "bookmarks.json")
    bookmarks.open(scene)
    assert bookmarks.kept == ()
    bookmarks.add(PathSample(make_pose(1), 1))
    assert len(bookmarks.kept) == 1
