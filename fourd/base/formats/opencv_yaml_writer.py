"""Writing of the YAML that OpenCV's class FileStorage reads: lists of names, whole numbers and matrices.

FileStorage itself writes only keys of letters, digits, spaces, ``-`` and ``_``, but it reads every key without a colon
and without control characters. This writer therefore escapes only the remaining keys. For all content that FileStorage
can write, except negative zeros, it writes the same bytes as FileStorage.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Value = int | float | Sequence[str] | NDArray[np.float64]
"""A value to write: a finite number, a list of strings, or a matrix (rows, columns) of finite numbers."""

_PLAIN = re.compile(r"[A-Za-z_](?:[A-Za-z0-9_ -]*[A-Za-z0-9_-])?")
_WORDS = frozenset(("true", "false", "yes", "no", "on", "off", "y", "n", "null", "inf", "nan"))
"""Words that YAML reads as a truth value, as no value, or as a number, unless they are quoted."""
_UNREADABLE = re.compile(r"[:\x00-\x1f\x7f]|\s(?=\s*$)|%(?=[0-9A-F]{2})")
"""The characters of a key that FileStorage cannot read, and the percent signs that look like escaped characters."""
_MAX_LINE = 71
"""Number of characters after which FileStorage continues a matrix in a new line."""
_MAX_INTEGER = 2**31


def escape_key(key: str) -> str:
    """Return the key under which a value is stored: ``key`` itself if FileStorage can read it. Otherwise, each
    character that FileStorage cannot read is replaced by the hexadecimal codes of its UTF-8 bytes, such as ``%3A`` for
    a colon. Different keys have different results."""
    return _UNREADABLE.sub(lambda match: "".join(f"%{byte:02X}" for byte in match[0].encode()), key)


def write_opencv_yaml(entries: Mapping[str, Value]) -> str:
    """Return the text of a YAML file with the given keys and values. Keys must be escaped by :func:`escape_key`.

    Raises:
        ValueError: if a matrix contains a number that is not finite, or a string contains a control character.
    """
    lines = ["%YAML 1.2", "---"]
    for key, value in entries.items():
        if isinstance(value, int):
            lines.append(f"{key}: {value}")
        elif isinstance(value, float):
            lines.append(f"{key}: {_number(value)}")
        elif isinstance(value, np.ndarray):
            lines += _matrix_lines(key, value)
        else:
            lines += [f"{key}:", *(f"   - {_quoted(item)}" for item in value)]
    return "\n".join(lines) + "\n"


def _matrix_lines(key: str, matrix: NDArray[np.float64]) -> list[str]:
    if not np.isfinite(matrix).all():
        raise ValueError(f"{key}: expected finite numbers, got {matrix.ravel().tolist()}")
    rows, columns = matrix.shape
    lines = [f"{key}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d", "   data: ["]
    for index, value in enumerate(matrix.ravel().tolist()):
        item = _number(value)
        lines[-1] += "," if index else ""
        if len(lines[-1]) + len(item) > _MAX_LINE:
            lines.append("      ")
        lines[-1] += f" {item}"
    lines[-1] += " ]"
    return lines


def _number(value: float) -> str:
    """Return the shortest text of at most 17 digits with a dot for whole numbers, as FileStorage writes them. Reading
    the text returns the same number to the last bit."""
    if value == round(value) and abs(value) < _MAX_INTEGER:
        return "-0." if value == 0 and np.signbit(value) else f"{round(value)}."
    return format(value, ".17g")


def _quoted(text: str) -> str:
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    if re.search(r"[\x00-\x1f\x7f]", text):
        raise ValueError(f"expected a string without control characters, got {text!a}")
    return '"' + re.sub(r"[\\\"']", r"\\\g<0>", text) + '"'
