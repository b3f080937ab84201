"""Checked access to the JSON of a manifest, which is untrusted input."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

MAX_NAME = 255
Option = TypeVar("Option", bound=str)


class ManifestError(ValueError):
    """Raised for an invalid manifest. The message has the form "where: expected ..., got ..."."""


class JsonNode:
    """Wraps a JSON object, and records the object's path inside the manifest for error messages."""

    def __init__(self, content: object, where: str) -> None:
        if not isinstance(content, dict):
            raise ManifestError(f"{where}: expected a JSON object, got {_format(content)}")
        self.content: dict[str, Any] = content
        self.where = where

    def get(self, key: str) -> object:
        if key not in self.content:
            raise ManifestError(f'{self.where}: expected a key "{key}", got none')
        return self.content[key]

    def fail(self, key: str, expected: str) -> ManifestError:
        return ManifestError(f"{self.where}, {key}: expected {expected}, got {_format(self.content[key])}")

    def node(self, key: str) -> JsonNode:
        return JsonNode(self.get(key), f"{self.where}, {key}")

    def items(self, key: str, max_count: int) -> list[JsonNode]:
        value = self.get(key)
        if not isinstance(value, list) or len(value) > max_count:
            raise self.fail(key, f"a list of at most {max_count} objects")
        return [JsonNode(item, f"{self.where}, {key}[{index}]") for index, item in enumerate(value)]

    def text(self, key: str) -> str:
        value = self.get(key)
        if not isinstance(value, str) or len(value) > MAX_NAME or not value.isprintable():
            raise self.fail(key, f"printable text of at most {MAX_NAME} characters")
        return value

    def choice(self, key: str, options: Sequence[Option]) -> Option:
        """Return the text value of a key, which must be one of ``options``."""
        text = self.text(key)
        for option in options:
            if text == option:
                return option
        quoted = [f'"{option}"' for option in options]
        raise self.fail(key, f"{', '.join(quoted[:-1])} or {quoted[-1]}")

    def integer(self, key: str, low: int, high: int) -> int:
        value = self.get(key)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self.fail(key, f"a whole number from {low} to {high}")
        return value

    def flag(self, key: str) -> bool:
        value = self.get(key)
        if not isinstance(value, bool):
            raise self.fail(key, "true or false")
        return value

    def number(self, key: str, low: float, high: float) -> float:
        value = _finite(self.get(key))
        if value is None or not low <= value <= high:
            raise self.fail(key, f"a number from {low:g} to {high:g}")
        return value

    def numbers(self, key: str, count: int) -> list[float]:
        value = self.get(key)
        numbers = [_finite(item) for item in value] if isinstance(value, list) and len(value) == count else []
        found = [number for number in numbers if number is not None]
        if len(found) != count:
            raise self.fail(key, f"{count} finite numbers")
        return found

    def array(self, key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Return the numbers of a flat list as an array of the given shape."""
        return np.array(self.numbers(key, math.prod(shape)), np.float64).reshape(shape)

    def triple(self, key: str) -> tuple[float, float, float]:
        x, y, z = self.numbers(key, 3)
        return x, y, z

    def matrix(self, key: str) -> list[list[float]]:
        rows = self.get(key)
        if not isinstance(rows, list) or len(rows) != 3:
            raise self.fail(key, "3 rows of 3 finite numbers")
        return [JsonNode({"row": row}, f"{self.where}, {key}").numbers("row", 3) for row in rows]


def _finite(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) and abs(number) < 1e30 else None


def _format(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
