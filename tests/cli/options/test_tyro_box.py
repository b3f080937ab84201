"""The box that tyro prints for a usage error, which fourd/cli/usage.py shortens to one line."""

from __future__ import annotations

import io
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
import tyro

from fourd.cli.usage import COLOUR, FRAME, RULE, condense

BOXES = {
    "scene": (
        "Missing from fourd draw: / -o PATH, --out PATH / Where to write. (required) / ---",
        "expected --out PATH, got none; see --help",
    ),
    "scene -o x --size big": (
        "Error parsing --size: invalid literal for int() with base 10: 'big' / ---"
        " / Argument helptext: / --size INT / Width in pixels. (default: 8) / ---",
        "--size: expected INT, got 'big'; see --help",
    ),
    "scene -o x --size": (
        "Missing value for argument '--size'. Expected 1 values. / ---",
        "--size: expected a value, got none; see --help",
    ),
    "scene -o x --crop 3": (
        "Error parsing --crop: no type matching {None}|{INT INT} could be / instantiated from ['3']. / Got errors:",
        "--crop: expected {None}|{INT INT}, got '3'; see --help",
    ),
    "scene -o x --mode c": (
        "invalid choice 'c' for argument '--mode'. Expected one of ('a', 'b'). / ---",
        "--mode: expected one of 'a', 'b', got 'c'; see --help",
    ),
    "scene -o x --sizes 3": (
        "Unrecognized options: --sizes, 3 / ---"
        " / Perhaps you meant: / --size INT / Width in pixels. (default: 8) / ---",
        "Unrecognized options: --sizes, 3; did you mean --size?",
    ),
    "scene -o x other": ("Unrecognized options: other / ---", "Unrecognized options: other; see --help"),
}
"""For each command line, the first lines of tyro's box below its title, separated by slashes, and the line that fourd
prints. Rules are written as "---"."""


@dataclass
class Arguments:
    """Draws a scene."""

    scene: tyro.conf.Positional[Path]
    """The scene."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Where to write."""
    size: int = 8
    """Width in pixels."""
    crop: tuple[int, int] | None = None
    """First row and column."""
    mode: Literal["a", "b"] = "a"
    """Mode."""


def print_box(words: str) -> str:
    """The box that tyro prints for a command line."""
    printed = io.StringIO()
    with redirect_stderr(printed), pytest.raises(SystemExit):
        tyro.cli(Arguments, args=words.split(), prog="fourd draw", config=(tyro.conf.OmitArgPrefixes,))
    return printed.getvalue()


def lines_below_title(box: str) -> list[str]:
    """The lines of a box without its title and its frame. Rules are "---"."""
    lines = [line.strip(FRAME) for line in COLOUR.sub("", box).splitlines()[1:]]
    return ["---" if RULE.match(line) else line for line in lines if line]


@pytest.mark.parametrize("words", BOXES)
def test_tyro_prints_the_box_that_is_shortened(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a version of tyro that prints another box, so that the errors of all commands get worse."""
    monkeypatch.setenv("COLUMNS", "80")
    expected = BOXES[words][0].split(" / ")
    found = lines_below_title(print_box(words))[: len(expected)]
    assert found == expected, (
        f"tyro {tyro.__version__} words its errors differently: adapt the patterns of fourd/cli/usage.py and BOXES, "
        "and the versions of tyro in pyproject.toml"
    )


@pytest.mark.parametrize("has_frame", [True, False])
@pytest.mark.parametrize("words", BOXES)
def test_a_box_becomes_one_line(words: str, has_frame: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a part of the box in the error, and a title that is taken for the error where tyro draws no frame."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setitem(tyro._experimental_options, "utf8_boxes", has_frame)
    assert condense(print_box(words)) == BOXES[words][1]
