"""The exception for errors that the user can fix."""

from __future__ import annotations


class UserError(Exception):
    """Invalid input. The CLI prints the one-line message and exits with code 2.

    The message names the file or argument, what was expected, what was found, and the fix.
    """
