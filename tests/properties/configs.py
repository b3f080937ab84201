"""Generated configs: dataclasses with random valid fields, their YAML text, and changed copies of this text."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

from hypothesis import strategies as st

Config = TypeVar("Config")

UNUSUAL = (
    "", "~", "null", "'null'", "true", "yes", "-1", "0", "1e999", "-.inf", ".nan", "0x10", "0o7", "1:24", "1_000",
    "9" * 70, "1e-400", "2001-01-01", "[]", "{}", "[1, 2", "{a: 1", "[[1]]", "[null, null]", "{a: {b: {c: 1}}}", "&a 1",
    "*a", "&a [*a]", "!!python/name:os.system x", "!!int '3'", "!!binary AA==", "!!set {a}", "!local 1", "? a", "- 1",
    "|\n  text", ">\n  text", "# comment", "---", "...", "%YAML 9.9", "'", '"', '"\\x00"', '"\\ud800"', "\t", "a: b: c",
    "<<: {points: 1}", "[" * 300, "{a: " * 300, "=", "\u2028", "\ufeff", "caf\u00e9",
)  # fmt: skip
"""YAML values that some YAML readers convert, reject or execute, and pieces of invalid YAML."""

LIKE_OTHER_TYPES = ("null", "true", "05", "1e3", "1:24", "~", " a", "-", "#", "2001-01-01", "=", "<<")
"""Texts that YAML reads as other values if they are not in quotes."""

LETTERS = st.characters(exclude_categories=("Cs",), exclude_characters="\0")
"""Characters of texts in a config. Lone surrogates are excluded, because UTF-8 cannot encode them."""


def values(kind: Any) -> st.SearchStrategy[Any]:
    """Random values of a field's type. NaN is excluded, because configs do not accept NaN."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Union, types.UnionType):
        return st.one_of(*(st.none() if each is type(None) else values(each) for each in arguments))
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin is tuple and arguments[-1] is Ellipsis:
        return st.lists(values(arguments[0]), max_size=3).map(tuple)
    if origin is tuple:
        return st.tuples(*(values(each) for each in arguments))
    kinds: dict[Any, st.SearchStrategy[Any]] = {
        bool: st.booleans(),
        int: st.integers(0, 20) | st.integers(),
        float: st.floats(0, 2) | st.floats(allow_nan=False),
        str: st.text(LETTERS, max_size=12)
        | st.sampled_from(["null", "true", "05", "1e3", "1:24", "~", " a", "-", "#"]),
        Path: st.text(LETTERS, min_size=1, max_size=12).map(Path),
    }
    return kinds[kind]


def paths_of(config: object, prefix: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """The names and types of all fields, including the fields of nested dataclasses."""
    hints = typing.get_type_hints(type(config))
    for field in dataclasses.fields(config):  # type: ignore[arg-type]
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from paths_of(value, (*prefix, field.name))
        else:
            yield (*prefix, field.name), hints[field.name]


def with_value(config: Config, path: tuple[str, ...], value: object) -> Config:
    """A copy of the config in which the field ``path`` has the value ``value``. Raises ValueError if the config does
    not accept the value.
    """
    if len(path) > 1:
        value = with_value(getattr(config, path[0]), path[1:], value)
    return dataclasses.replace(config, **{path[0]: value})  # type: ignore[type-var]


@st.composite
def configs(draw: st.DrawFn, base: Config) -> Config:
    """Copies of ``base`` with random values in up to six fields."""
    fields = list(paths_of(base))
    for index in draw(st.lists(st.integers(0, len(fields) - 1), max_size=6)):
        path, kind = fields[index]
        try:
            base = with_value(base, path, draw(values(kind)))
        except ValueError:
            continue
    return base


@st.composite
def changed_lines(draw: st.DrawFn, text: str) -> str:
    """Copies of YAML text with one to three changed lines."""
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, 3))):
        index = draw(st.integers(0, max(0, len(lines) - 1)))
        line = lines[index] if lines else ""
        piece = draw(st.sampled_from(UNUSUAL) | st.text(LETTERS, max_size=6))
        how = draw(st.sampled_from(("value", "insert", "remove", "repeat", "indent", "letter")))
        head, colon, _rest = line.partition(":")
        at = draw(st.integers(0, len(line)))
        changed = {
            "value": [f"{head}{colon} {piece}"],
            "insert": [piece, line],
            "remove": [],
            "repeat": [line, line],
            "indent": [" " + line],
            "letter": [line[:at] + piece + line[at + 1 :]],
        }
        lines[index : index + 1] = changed[how]
    return "\n".join(lines)


@st.composite
def assignments(draw: st.DrawFn, base: object) -> str:
    """Arguments of --set: a key, which usually exists, and an arbitrary value."""
    keys = [".".join(path) for path, _ in paths_of(base)]
    groups = [key.rpartition(".")[0] for key in keys if "." in key]
    key = draw(st.sampled_from(keys) | st.sampled_from(groups) | st.sampled_from(("", ".", "a.", "points.a", "\ud800")))
    text = draw(st.sampled_from(UNUSUAL) | st.text(max_size=8) | st.integers().map(str) | st.floats().map(repr))
    return f"{key}{draw(st.sampled_from(('=', '==', ' = ', '')))}{text}"
