"""Typed decoding of JSON that fourd does not trust.

The type of a JSON object is a frozen dataclass. Its fields can have the types of JSON, tuples, other such dataclasses,
fractions and flat arrays. Ranges are written as ``Annotated[int, Meta(ge=1, le=64)]``. A whole number is valid as a
float, but neither a float nor a truth value as a whole number. Keys that the dataclass does not have are skipped.
"""

from __future__ import annotations

import re
import reprlib
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin

import msgspec
import numpy as np
from msgspec import Meta

from fourd.base.limits import MAX_TEXT_BYTES, read_fraction, read_json

T = TypeVar("T")

Finite = Annotated[float, Meta(gt=-1e30, lt=1e30)]
"""A number that is finite, also as float32. A plain ``float`` could be NaN or infinity: Python's parser accepts NaN,
and reads 1e999 as infinity."""
Vector = tuple[Finite, Finite, Finite]
Matrix = tuple[Vector, Vector, Vector]
"""A matrix (3, 3), as a list of rows."""
_WORDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "object": "a JSON object",
    "array": "a list",
}


def read_json_as(path: Path | str, kind: type[T], max_bytes: int = MAX_TEXT_BYTES) -> T:
    """Read a JSON file and decode it. Raises the same errors as ``read_json`` and :func:`decode_json`."""
    return decode_json(read_json(path, max_bytes), kind)


def decode_json(content: Any, kind: type[T]) -> T:
    """Convert parsed JSON to ``kind``, a dataclass or another type that the module's docstring lists.

    Raises ValueError for other content. Its message is one line of the form "frames[0], points: expected a whole number
    >= 0, got -1". A ValueError that a dataclass raises in ``__post_init__`` gets the same form.
    """
    try:
        return msgspec.convert(content, kind, dec_hook=_decode_other)
    except msgspec.ValidationError as error:
        raise ValueError(_message(str(error), content)) from error


def require_printable(name: str, text: str) -> None:
    """Raise ValueError if a text has characters that do not print, such as newlines."""
    if not text.isprintable():
        raise ValueError(f"{name}: expected printable text, got {reprlib.repr(text)}")


def _decode_other(kind: Any, value: object) -> Any:
    if kind is Fraction:
        return read_fraction(value)
    if get_origin(kind) is not np.ndarray:
        raise NotImplementedError(f"expected a type that JSON can have, got {kind}")
    return np.array(decode_json(value, list[Finite]), get_args(get_args(kind)[1])[0])


def _message(error: str, content: Any) -> str:
    """Convert a message such as "Expected `int` >= 0 - at `$.frames[0].points`", and add the value."""
    match = re.fullmatch(r"(.*?)(?: - at `\$([\w.\[\]]*)`)?", error, re.DOTALL)
    text, path = (match[1], match[2] or "") if match else (error, "")
    if text.startswith("Expected "):
        words = re.sub(r"\w+", lambda word: _WORDS.get(word[0], word[0]), text[9:].split(", got ")[0])
        text = f"expected {words.replace('`', '').replace(' | ', ' or ')}, got {_value_at(content, path)}"
    elif text.startswith("Object missing"):
        text = f'expected a key "{text.split("`")[1]}", got none'
    elif text.startswith("Invalid enum value") or text.endswith("out of range"):
        text = f"expected a value that is possible here, got {_value_at(content, path)}"
    place = re.sub(r"\.(?=\w)", ", ", path.lstrip("."))
    is_inside = re.match(r"[\w\[\]]+: ", text)  # a message of __post_init__ can start with the name of a field
    return f"{place}{', ' if is_inside else ': '}{text}" if place else text


def _value_at(content: Any, path: str) -> str:
    """Return the value at a path as text. Paths do not have the keys of dicts, but "[...]" instead of them."""
    for step in re.findall(r"\w+|\.\.\.", path):
        if step == "...":
            return "another value"
        content = content[int(step)] if isinstance(content, list) else content[step]
    return reprlib.repr(content)
