"""Report a usage error as one line instead of the box that tyro prints.

tyro has no public interface to its errors: its module ``_errors`` is private and may change in any release. The
constants below therefore match the text of the box. If a version of tyro prints another text, the errors are longer
lines, and tests/cli/options/test_tyro_box.py fails.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr

from fourd.base.errors import UserError

FRAME = " \t│|"
RULE = re.compile(r"^[─\-+╭╮╰╯ ]{3,}")
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
BAD_VALUE = re.compile(r"Error parsing \S+: .*?(from \[(?P<got>.*)\]|: (?P<literal>'.*'))$")
BAD_CHOICE = re.compile(r"invalid choice (?P<got>.*) for argument '(?P<name>.*)'\. Expected one of \((?P<known>.*)\)")
MISSING_VALUE = re.compile(r"Missing value for argument '(?P<name>.*)'\. Expected")
MISSING = "Missing from"
REQUIRED = "(required)"
HELP = "Argument helptext:"


@contextmanager
def one_line_of_usage() -> Iterator[None]:
    """Catch tyro's exit after a usage error and raise a one-line UserError instead.

    An exit with code 0, as after --help, is not caught.
    """
    printed = io.StringIO()
    try:
        with redirect_stderr(printed):
            yield
    except SystemExit as exit_:
        if exit_.code in (0, None):
            raise
        raise UserError(condense(printed.getvalue())) from exit_


def condense(box: str) -> str:
    """Shorten tyro's error box to one line, which consists of the first section of the box and the option that tyro
    suggests."""
    sections: list[list[str]] = [[]]
    for line in COLOUR.sub("", box).splitlines():
        text = line.strip(FRAME)
        if RULE.match(text):
            sections.append([])
        elif text:
            sections[-1].append(text)
    filled = [section for section in sections if section] or [["the options cannot be parsed"]]
    if len(filled) > 1 and len(filled[0]) == 1 and not filled[0][0].endswith(".") and ":" not in filled[0][0]:
        del filled[0]  # on terminals without box-drawing characters, tyro prints the box's title above it
    if filled[0][0].startswith(MISSING):
        return f"expected {' and '.join(_missing(filled[0][1:]))}, got none; see --help"
    message = " ".join(filled[0]).split(" Got errors:")[0].rstrip(".")
    described = next((section[1] for section in filled if section[0] == HELP and len(section) > 1), None)
    bad_value, bad_choice = BAD_VALUE.match(message), BAD_CHOICE.match(message)
    if bad_value is not None and described is not None:
        name, _, metavar = described.partition(" ")
        return f"{name.rstrip(',')}: expected {metavar}, got {bad_value['got'] or bad_value['literal']}; see --help"
    if bad_choice is not None:
        known = ", ".join(sorted(word for word in bad_choice["known"].split(", ") if word != "'None'"))
        return f"{bad_choice['name']}: expected one of {known}, got {bad_choice['got']}; see --help"
    missing_value = MISSING_VALUE.match(message)
    if missing_value is not None:
        return f"{missing_value['name']}: expected a value, got none; see --help"
    suggested = next(
        (section[1] for section in filled[1:] if section[0].startswith("Perhaps") and len(section) > 1), None
    )
    hint = f"did you mean {suggested.split()[0]}?" if suggested else "see --help"
    return f"{message}; {hint}"


def _missing(lines: list[str]) -> list[str]:
    """Return the names of the missing options.

    tyro lists each missing option as one line with its names, followed by lines of help that end with "(required)".
    """
    names = [name for before, name in zip([REQUIRED, *lines], lines, strict=False) if before.endswith(REQUIRED)]
    return [name.rpartition(", ")[2] for name in names]
