"""The exception for errors that the user can fix."""

from __future__ import annotations


class UserError(Exception):
    """Invalid input. The CLI prints the one-line error message and exits with code 2.

    The error message names the file or argument, the expected value, the value found, and the fix.
    """
