"""Mistyped options as one line: tyro draws boxes of a dozen."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr

from fourd.errors import UserError

FRAME = " \t│|"
RULE = re.compile(r"^[─\-+╭╮╰╯ ]{3,}")
COLOUR = re.compile(r"\x1b\[[0-9;]*m")


@contextmanager
def one_line_of_usage() -> Iterator[None]:
    """Turn the box that tyro prints before it exits into a UserError of one line; --help exits as ever."""
    told = io.StringIO()
    try:
        with redirect_stderr(told):
            yield
    except SystemExit as ended:
        if ended.code in (0, None):
            raise
        raise UserError(condensed(told.getvalue())) from ended


def condensed(box: str) -> str:
    """The first section of tyro's box in one line, with the option that it thinks was meant."""
    sections: list[list[str]] = [[]]
    for line in COLOUR.sub("", box).splitlines():
        text = line.strip(FRAME)
        if RULE.match(text):
            sections.append([])
        elif text:
            sections[-1].append(text)
    filled = [section for section in sections if section] or [["the options cannot be understood"]]
    if len(filled) > 1 and len(filled[0]) == 1 and ":" not in filled[0][0]:
        del filled[0]  # the title, which lies above the frame where a terminal draws it without corners
    message = " ".join(filled[0]).split(" Got errors:")[0].rstrip(".")
    meant = next((section[1] for section in filled[1:] if section[0].startswith("Perhaps") and len(section) > 1), None)
    hint = f"did you mean {meant.split()[0]}?" if meant else "see --help"
    return f"{message}; {hint}"
