"""The one exception type for input that a user can mend."""

from __future__ import annotations


class UserError(Exception):
    """Input that the user must mend: the CLI prints its one line and exits with 2.

    The message names the file or argument, what was expected, what came, and the mend.
    """
