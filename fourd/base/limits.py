"""Limits for untrusted files (their kind, size and nesting), and a function that makes their text safe to print in a
terminal.

All readers of fourd open files through this module, or call :func:`require_regular` before a library opens the file.
"""

from __future__ import annotations

import json
import math
import os
import stat
from fractions import Fraction
from io import BufferedReader
from pathlib import Path
from typing import Any

from fourd.base.errors import UserError

MAX_TEXT_BYTES = 64 << 20
"""Maximum size in bytes of a file that is read into memory as a whole and parsed, such as JSON, YAML, TOML and XML
files."""
MAX_CALIBRATION_BYTES = 16 << 20
"""Maximum size in bytes of intri.yml and extri.yml. 1,000 cameras need about 1 MB."""
MAX_CONFIG_BYTES = 1 << 20
"""Maximum size in bytes of a file with settings."""
MAX_NUMBER = 64
"""Maximum number of characters of a number that is read from a file as an exact fraction."""
_MIN_READ = 1 << 16
"""Minimum number of bytes to try to read, even if a file reports a smaller size, because files in /proc report the size
0."""
_KINDS = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def require_regular(path: Path | str) -> None:
    """Raise UserError if ``path`` is a named pipe, a socket or a device, because reading it may never end.

    Symbolic links are followed. No error is raised for a folder or a missing path, because opening it raises one later.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    _require_regular_mode(path, mode)


def open_regular(path: Path | str) -> BufferedReader:
    """Open a regular file for reading. Opening never blocks, and nothing is read from pipes and devices.

    Raises:
        UserError: if ``path`` is a named pipe, a socket or a device.
        OSError: if ``path`` is missing, is a folder, or cannot be opened.
    """
    # The kind of the file is checked before it is opened, because opening a device can have side effects. It is checked
    # again afterwards, because another process may have replaced the file in between. Only the stream closes the
    # descriptor. If other code could close it too, a Ctrl-C at the wrong moment could make both close it. At the second
    # close, the descriptor's number may already belong to a file that another thread has opened.
    _require_regular_mode(path, os.stat(path).st_mode)
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
    # Opening raises IsADirectoryError for folders.
    stream = open(path, "rb", opener=lambda name, _: os.open(name, flags))  # noqa: SIM115
    try:
        _require_regular_mode(path, os.fstat(stream.fileno()).st_mode)
    except BaseException:
        stream.close()
        raise
    return stream


def read_limited(path: Path | str, max_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Read the content of a regular file of at most ``max_bytes`` bytes.

    Raises the same errors as :func:`open_regular`, and UserError for larger files.
    """
    with open_regular(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        content = stream.read(max(size, _MIN_READ) + 1) if size <= max_bytes else b""
    if max(size, len(content)) > max_bytes:
        raise UserError(
            f"{path}: expected at most {max_bytes / 2**20:g} MB, got {max(size, len(content)) / 2**20:.1f} MB; "
            "check that the file is the right one"
        )
    return content


def read_text_limited(path: Path | str, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Read a file as UTF-8 text, with the same size limit and errors as :func:`read_limited`. Also raises
    UnicodeDecodeError, a ValueError, if the bytes are not UTF-8."""
    return read_limited(path, max_bytes).decode("utf-8")


def read_json(path: Path | str, max_bytes: int = MAX_TEXT_BYTES) -> Any:
    """Parse a JSON file. Raises the same errors as :func:`read_limited`, and ValueError if the content is not JSON."""
    return parse_json(read_limited(path, max_bytes))


def parse_json(content: bytes) -> Any:
    """Parse UTF-8 JSON. Raises ValueError, with a message of one line, for other content and for deeply nested JSON."""
    try:
        return json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        reason = error if isinstance(error, ValueError) else "deeply nested lists"
        raise ValueError(f"expected UTF-8 JSON, got other content ({reason})") from error


def read_fraction(value: object) -> Fraction:
    """Convert a value from a file, such as 25, 29.97 or "30000/1001", to an exact fraction.

    Raises TypeError or ValueError for other values. Numbers with exponents or more than 64
    characters are also refused, because they could fill the memory: as a fraction, the text "1e99999999" would need
    gigabytes.
    """
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise TypeError("expected a number")
    text = str(value)
    if len(text) > MAX_NUMBER or (isinstance(value, str) and "e" in text.lower()):
        raise ValueError(f"expected a number of at most {MAX_NUMBER} characters without an exponent")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"expected a finite number, got {value}")
    try:
        return Fraction(value)
    except ZeroDivisionError as error:
        raise ValueError("expected a fraction, got a division by zero") from error


def printable(text: str) -> str:
    """Replace each character that does not print, such as ESC and newline, by its escape sequence, such as ``\\x1b``.

    Unescaped, names and texts from files could change the terminal's state or add lines to the output.
    """
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape", "surrogatepass").decode("ascii")
        for character in text
    )


def _require_regular_mode(path: Path | str, mode: int) -> None:
    kind = next((name for is_kind, name in _KINDS if is_kind(mode)), None)
    if kind is not None:
        raise UserError(f"{path}: expected a file, got {kind}; name a file")
