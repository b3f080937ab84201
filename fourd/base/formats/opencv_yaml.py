"""Reading of the YAML that OpenCV's class FileStorage writes: numbers, strings, lists of both, and matrices.

This reader replaces OpenCV's own parser, which recurses without bound on nested content and corrupts memory if a matrix
is incomplete. It accepts only the types that calibrations contain, and takes a time proportional to the size of the
file. An entry is parsed only when its value is requested, so a file can also contain entries of other types.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fourd.base.limits import MAX_NUMBER

MAX_ITEMS = 10_000
"""Maximum number of items of a list or of a matrix."""
Item = float | str
"""An item of a list: a number, or a string."""

_NUMBER = re.compile(r"[-+]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|\.(?:inf|nan))", re.IGNORECASE)
_GAP = re.compile(r"(?:\s++|#[^\n]*+)*+")
"""Spaces and comments. The possessive quantifiers make the time of a failed match proportional to the length of the
text."""
_ITEM = re.compile(
    _GAP.pattern
    + r"""(?:"(?P<double>(?:[^"\\\n]|\\.){0,1000}+)"|'(?P<single>(?:[^'\n]|''){0,1000}+)'"""
    + r"""|(?!-\s)(?P<plain>[^\s,\[\]{}"'#:][^,\[\]{}"':\n]{0,1000}+))"""
    + _GAP.pattern
)
_FIELD = re.compile(r"[ ]+([A-Za-z_]+)[ ]*:(.*)")
_ESCAPES = {"n": "\n", "r": "\r", "t": "\t"}


class OpenCvYaml:
    """The entries of a YAML file that OpenCV's class FileStorage wrote. The methods parse one entry each.

    Args:
        text: the whole content of the file.

    Raises:
        ValueError: if the text does not have FileStorage's format. The message says what was found instead.
    """

    def __init__(self, text: str) -> None:
        self._entries = dict(_entries(text))

    def __contains__(self, key: str) -> bool:
        return key in self._entries

    def number(self, key: str) -> float | None:
        """Return the number with the key ``key``, or None if the value is not a number. The number may be infinite or
        NaN."""
        item = _single_item(self._entries[key])
        return item if isinstance(item, float) else None

    def items(self, key: str) -> list[Item] | None:
        """Return the items of a list of numbers and strings, or None if the value is not such a list.

        The list is written in brackets or with one dash per line. An item without quotes is a number if it looks like a
        number.
        """
        found = self._matches(key)
        return None if found is None else [_value(match) for match in found]

    def strings(self, key: str) -> list[str] | None:
        """Return the items of a list like :meth:`items`, but as strings. An item without quotes is returned as it is
        written, even if it looks like a number."""
        found = self._matches(key)
        return None if found is None else [_text(match) for match in found]

    def _matches(self, key: str) -> list[re.Match[str]] | None:
        text = _without_tag(self._entries[key])
        try:
            return _bracketed(text) if text.lstrip().startswith("[") else _dashed(text)
        except ValueError:
            return None

    def matrix(self, key: str) -> NDArray[np.float64] | None:
        """Return the value with the key ``key`` as an array: a matrix (rows, columns), a matrix whose elements have
        several channels (rows, columns, channels), or a list of numbers (N,). Returns None if it has none of these
        types.

        Raises:
            ValueError: if a matrix is incomplete.
        """
        text = _without_tag(self._entries[key])
        fields = _fields(text)
        if "data" not in fields and "rows" not in fields:
            items = self.items(key)
            is_list = items is not None and all(isinstance(item, float) for item in items)
            return np.array(items, np.float64) if is_list else None
        values = [_value(match) for match in _bracketed(fields.get("data", ""))]
        channels = re.fullmatch(r'\s*"?([0-9]?)[a-z]"?\s*', fields.get("dt", "d"))
        sides = [_single_item(fields.get(side, "")) for side in ("rows", "cols")]
        shape = [int(side) for side in sides if isinstance(side, float) and side in range(1, MAX_ITEMS + 1)]
        if channels is not None and channels[1]:
            shape.append(int(channels[1]))
        is_whole = channels is not None and len(shape) >= 2 and int(np.prod(shape)) == len(values)
        if not is_whole or not all(isinstance(value, float) for value in values):
            raise ValueError("expected a complete matrix")
        return np.array(values, np.float64).reshape(shape)


def _entries(text: str) -> Iterator[tuple[str, str]]:
    """Yield the keys at the start of lines, each with the text up to the next key."""
    lines = text.removeprefix("\ufeff").split("\n")
    if lines[0].strip() == "names:":
        # Scripts that write the files without OpenCV leave the header out.
        lines.insert(0, "%YAML:1.0")
    if not lines[0].startswith("%YAML"):
        raise ValueError("another format")
    found: set[str] = set()
    key, value = "", [""]
    for number, line in enumerate(lines[1:], 2):
        line = line.rstrip()
        if line == "...":
            break
        if not line or line == "---" or line.lstrip().startswith("#"):
            continue
        if line[0] == " " and found:
            value.append(line)
            continue
        if found:
            yield key, "\n".join(value)
        key, colon, rest = line.partition(":")
        key, value = key.rstrip(" \t"), [rest]
        is_key = bool(colon) and (key[:1].isalpha() or key[:1] == "_")
        if not is_key or key in found:
            fault = "a second time" if is_key else "instead of KEY: VALUE"
            raise ValueError(f"'{line[:80]}' in line {number} {fault}")
        found.add(key)
    if found:
        yield key, "\n".join(value)


def _without_tag(text: str) -> str:
    return re.sub(r"^\s*!![\w-]+", "", text, count=1)


def _fields(text: str) -> dict[str, str]:
    """Split the text of a YAML mapping into its keys and values. OpenCV writes a matrix, for example, as a mapping with
    the keys ``rows``, ``cols``, ``dt`` and ``data``. A value ends at the next line with a key, and nested mappings are
    not supported."""
    fields: dict[str, list[str]] = {}
    name = None
    for line in text.split("\n")[1:]:
        match = _FIELD.fullmatch(line)
        if match is not None:
            name = match[1]
            fields[name] = [match[2]]
        elif name is not None:
            fields[name].append(line)
    return {name: "\n".join(lines) for name, lines in fields.items()}


def _single_item(text: str) -> Item | None:
    match = _ITEM.fullmatch(_without_tag(text))
    return None if match is None else _value(match)


def _bracketed(text: str) -> list[re.Match[str]]:
    """Return the items of a list in brackets, such as ``[ 1, "a" ]``. Raises ValueError if the text is not such a
    list."""
    head, bracket, body = text.partition("[")
    if head.strip() or not bracket:
        raise ValueError("expected a list in brackets")
    items: list[re.Match[str]] = []
    position = _gap_end(body, 0)
    separator = "]" if body[position : position + 1] == "]" else ","
    while separator == ",":
        match = _ITEM.match(body, position)
        if match is None or len(items) == MAX_ITEMS:
            raise ValueError(f"expected at most {MAX_ITEMS} numbers or strings in a list")
        items.append(match)
        separator = body[match.end() : match.end() + 1]
        position = match.end() + (separator == ",")
    if separator != "]" or _gap_end(body, position + 1) != len(body):
        raise ValueError("expected the end of a list")
    return items


def _gap_end(text: str, position: int) -> int:
    match = _GAP.match(text, position)
    return position if match is None else match.end()


def _dashed(text: str) -> list[re.Match[str]]:
    """Return the items of lines such as ``  - "a"``. Raises ValueError if any line has a different form."""
    first, *lines = text.split("\n")
    items: list[re.Match[str]] = []
    for line in lines:
        dash, item = line.lstrip()[:1], _ITEM.fullmatch(_without_tag(line.lstrip()[1:]))
        if dash != "-" or item is None or len(items) == MAX_ITEMS:
            raise ValueError(f"expected at most {MAX_ITEMS} numbers or strings, with dashes")
        items.append(item)
    if _gap_end(first, 0) < len(first) or not items:
        raise ValueError("expected a list with dashes")
    return items


def _value(match: re.Match[str]) -> Item:
    text = _text(match)
    if match["plain"] is None or len(text) > MAX_NUMBER or not _NUMBER.fullmatch(text):
        return text
    return float(text.lower().replace(".", "") if text[-1].isalpha() else text)


def _text(match: re.Match[str]) -> str:
    if match["double"] is not None:
        return re.sub(r"\\(x[0-9a-fA-F]{2}|.)", _unescaped, match["double"])
    if match["single"] is not None:
        return match["single"].replace("''", "'")
    return re.split(r"\s#", match["plain"], maxsplit=1)[0].rstrip()


def _unescaped(match: re.Match[str]) -> str:
    code = match[1]
    return chr(int(code[1:], 16)) if len(code) == 3 else _ESCAPES.get(code, code)
