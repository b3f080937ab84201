"""The scenes that the viewer remembers."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.viewer.navigation.preferences import MAX_RECENT, Preferences, PreferencesFile


def test_recent_scenes_are_kept_in_order(tmp_path: Path) -> None:
    """Catches a scene that is listed twice, a list without limit, and an order that is lost in the file."""
    preferences = Preferences("light")
    for number in (*range(MAX_RECENT + 2), 5):
        preferences = preferences.with_recent(tmp_path / f"{number}.4dv")
    file = PreferencesFile(tmp_path / "state" / "window.json")
    file.save(preferences)
    assert file.load() == preferences
    names = [Path(path).stem for path in preferences.recent]
    assert names == ["5", "9", "8", "7", "6", "4", "3", "2"]


@pytest.mark.parametrize("text", ["", "[]", '{"theme": "pink"}', '{"recent": [1]}', '{"recent": "a"}'])
def test_a_damaged_file_counts_as_empty(text: str, tmp_path: Path) -> None:
    """Catches a viewer that cannot start because of its own state file."""
    path = tmp_path / "window.json"
    path.write_text(text)
    assert PreferencesFile(path).load() == Preferences()
    assert PreferencesFile(tmp_path).load() == Preferences()
