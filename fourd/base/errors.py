"""The exception for errors that the user can fix, and functions for quoting other errors and commands in its
message."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

MAX_REASON = 200
"""Maximum number of characters that an error message quotes from the message of another program."""


class UserError(Exception):
    """An error that the user can fix, such as invalid input. The CLI prints its one-line message and exits with code 2.

    The message names the file or argument, the expected value, the value found, and the fix.
    """

    def _render_traceback_(self) -> list[str]:
        """Return what notebooks show in place of a traceback."""
        return [f"UserError: {self}"]


def one_line(error: Exception, max_length: int | None = None) -> str:
    """Return the message of an error on one line, cut after ``max_length`` characters."""
    return " ".join(str(error).split())[:max_length]


def command_line(*words: object) -> str:
    """Join the words of a command so that the user can copy the command to a shell.

    Words with spaces and other special characters are quoted. A path that starts with a hyphen is written as ./-NAME,
    so that it is not taken for an option.
    """
    texts = [f"./{word}" if isinstance(word, Path) and str(word).startswith("-") else str(word) for word in words]
    return subprocess.list2cmdline(texts) if sys.platform == "win32" else shlex.join(texts)
