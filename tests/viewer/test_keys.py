"""The keys of the window and of the page, compared with the table in docs/viewer.md."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("imgui_bundle")

ROOT = Path(__file__).parents[2]
NAMES = {"[": "BracketLeft", "]": "BracketRight", "Left": "ArrowLeft", "Right": "ArrowRight", "Esc": "Escape"}
"""Names of keys in browsers. Letters, digits and the other keys have the names that _code() returns."""


def documented(column: int) -> dict[str, str]:
    """The keys of the window (column 1) or the page (column 2) in the table of docs/viewer.md, with their effects."""
    text = (ROOT / "docs" / "viewer.md").read_text()
    table = text[text.index("| effect | window | page |") :].split("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in table]
    return {row[column]: row[0] for row in rows if row[column]}


def page_help() -> dict[str, str]:
    """The keys in the help of the page, with their effects."""
    text = (ROOT / "viewer" / "web" / "ui" / "panel.js").read_text()
    listed = text[text.index("const HELP = [") : text.index("];", text.index("const HELP = ["))]
    return dict(re.findall(r'\["(.+?)", "(.+?)"\]', listed))


def _code(key: str) -> str:
    if key in NAMES:
        return NAMES[key]
    if key.isdigit():
        return f"Digit{key}"
    return f"Key{key}" if re.fullmatch("[A-Z]", key) else key


def test_the_table_lists_the_keys_of_the_window() -> None:
    """Catches a shortcut of the window that the table lacks, and a table that names other keys."""
    from fourd.viewer.overlay.help import ROWS

    assert documented(1) == dict(ROWS)


def test_the_table_lists_the_keys_of_the_page() -> None:
    """Catches a key in the help of the page that the table lacks, and one that the page ignores."""
    assert documented(2) == page_help()
    text = (ROOT / "viewer" / "web" / "ui" / "shortcuts.js").read_text()
    actions = text[text.index("const actions = {") : text.index("};")]
    handled = set(re.findall(r"^\s+\"?(\?|\w+)\"?: \(\) =>", actions, re.MULTILINE))
    labels = [keys for keys in page_help() if not re.search("drag|fly|W A S D", keys)]
    assert handled == {_code(key) for keys in labels for key in re.split(", | and ", keys)}


def test_no_key_has_two_meanings() -> None:
    """Catches two shortcuts for the same key, and a shortcut for a key with which the view flies."""
    from imgui_bundle import imgui

    from fourd.viewer.keys import SHORTCUTS

    pressed = [(key, shortcut.needs_ctrl) for shortcut in SHORTCUTS for key, _ in shortcut.actions]
    flying = [(getattr(imgui.Key, letter), False) for letter in "wasdqe"]
    assert len({*pressed, *flying}) == len(pressed) + len(flying)


def test_the_window_and_the_page_agree() -> None:
    """Catches a key that does one thing in the window and another on the page."""
    window = {key: effect for keys, effect in documented(1).items() for key in re.split(", | and ", keys)}
    for keys, effect in documented(2).items():
        for key in re.split(", | and ", keys):
            if key in window and key != "Esc":
                assert window[key] == effect, key
