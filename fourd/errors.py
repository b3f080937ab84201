"""The exception for errors that the user can fix, and a function for quoting other errors in its message."""

from __future__ import annotations

MAX_REASON = 200
"""Maximum number of characters that an error message quotes from the message of another program."""


class UserError(Exception):
    """An error that the user can fix, such as invalid input. The CLI prints its one-line message and exits with code 2.

    The message names the file or argument, the expected value, the value found, and the fix.
    """


def one_line(error: Exception, max_length: int | None = None) -> str:
    """Return the message of an error on one line, cut after ``max_length`` characters."""
    return " ".join(str(error).split())[:max_length]
