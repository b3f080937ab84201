"""Typed dataclass configs to YAML and back: an unknown key or a wrong type is an error that names it.

Scalars are read by the type of the field they are for, not by what YAML 1.1 takes them for:
``test_views: [05, 11]`` gives the names "05" and "11", ``frames: 1:24`` is no sexagesimal number,
and ``rate: 1e-3`` is a number. Nothing in a file can make an object of another type.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import types
import typing
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

import yaml

from fourd.errors import UserError
from fourd.files import write_text_atomically

Config = TypeVar("Config")

_INTEGER = re.compile(r"[-+]?[0-9][0-9_]*")
_FLOAT = re.compile(r"[-+]?([0-9][0-9_]*\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)")
_STRING_TAG = "tag:yaml.org,2002:str"
_NULL_TAG = "tag:yaml.org,2002:null"
_BOOL_TAG = "tag:yaml.org,2002:bool"
_PLAIN_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "timestamp")}


def load_overlay(base: Config, path: Path) -> Config:
    """``base`` with the values that the YAML file ``path`` gives; what it does not name stays.

    Args:
        base: a frozen dataclass instance. Fields may be bool, int, float, str, Path, Literal,
            tuples of these, any of them or None, and further dataclasses.
        path: a YAML mapping of field names to values; an empty file changes nothing.

    Raises:
        UserError: naming the file, the key and the line: no such file, no YAML, a key that is unknown
            (the nearest known one is named) or there twice, a value of the wrong type, or one that
            the dataclass's ``__post_init__`` refuses by a ValueError.
        TypeError: a field's type is none of those above (a fault of the program).
    """
    node = _parsed(path)
    if node is None:
        return base
    return _overlaid(base, node, _Place(path, ""))


def to_yaml(config: object) -> str:
    """All fields of a dataclass as YAML text that :func:`load_overlay` reads back to an equal instance."""
    return yaml.dump(_plain(config), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000)


def save_config(config: object, path: Path) -> None:
    """Write :func:`to_yaml`'s text in one indivisible step."""
    write_text_atomically(path, to_yaml(config))


@dataclasses.dataclass(frozen=True)
class _Place:
    """Where in which file a value lies, for errors."""

    path: Path
    key: str

    def below(self, name: str) -> _Place:
        return _Place(self.path, f"{self.key}.{name}" if self.key else name)

    def element(self, index: int) -> _Place:
        return _Place(self.path, f"{self.key}[{index}]")

    def error(self, node: yaml.Node, message: str) -> UserError:
        label = f" {self.key}:" if self.key else ""
        return UserError(f"{self.path}, line {node.start_mark.line + 1}:{label} {message}")


class _Dumper(yaml.SafeDumper):
    """Lists on one line, mappings indented; no anchors, which load_overlay has no use for."""

    def ignore_aliases(self, data: object) -> bool:
        return True


_Dumper.add_representer(list, lambda dumper, data: dumper.represent_sequence("tag:yaml.org,2002:seq", data, True))


def _parsed(path: Path) -> yaml.Node | None:
    """The file's node tree; composing makes nodes alone, so that no tag can make an object."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UserError(f"{path}: expected a YAML file, got '{error.strerror}'; name a readable file") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: expected UTF-8 text, got other bytes; save the file as UTF-8") from error
    try:
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f", line {mark.line + 1}" if mark else ""
        raise UserError(f"{path}{line}: expected YAML, got an error: {error.problem}; mend the line") from error
    except (yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{path}: expected YAML, got an error: {reason}; mend the file") from error


def _overlaid(base: Any, node: yaml.Node, place: _Place) -> Any:
    hints = typing.get_type_hints(type(base))
    known = [field.name for field in dataclasses.fields(base) if field.init]
    changes: dict[str, Any] = {}
    nodes: dict[str, yaml.Node] = {}
    for key, value in _entries(node, known, place):
        changes[key] = _value(hints[key], value, getattr(base, key), place.below(key))
        nodes[key] = value
    try:
        return dataclasses.replace(base, **changes)
    except ValueError as error:
        head = str(error).partition(":")[0]
        where = f"{place.key}." if place.key and head in known else f"{place.key}: " if place.key else ""
        line = nodes.get(head, node).start_mark.line + 1
        raise UserError(f"{place.path}, line {line}: {where}{error}; mend the value") from error


def _entries(node: yaml.Node, known: list[str], place: _Place) -> list[tuple[str, yaml.Node]]:
    """The mapping's keys, each known and there once, with their values' nodes; nothing is no keys."""
    if _plain_tag(node) == _NULL_TAG:
        return []
    if not isinstance(node, yaml.MappingNode):
        raise place.error(node, f"expected keys among {', '.join(known)}, got {_shown(node)}; write KEY: VALUE lines")
    seen: dict[str, int] = {}
    entries: list[tuple[str, yaml.Node]] = []
    for key_node, value in node.value:
        key = key_node.value if isinstance(key_node, yaml.ScalarNode) else _shown(key_node)
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            mend = f"did you mean '{near[0]}'?" if near else f"the keys here are {', '.join(known)}"
            raise place.error(key_node, f"expected a known key, got '{key}'; {mend}")
        if key in seen:
            raise place.error(
                key_node, f"expected each key once, got '{key}' here and in line {seen[key]}; remove one of them"
            )
        seen[key] = key_node.start_mark.line + 1
        entries.append((key, value))
    return entries


def _value(kind: Any, node: yaml.Node, base: Any, place: _Place) -> Any:
    """The node's value as ``kind``; ``base`` is what it replaces, for nested dataclasses."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return _overlaid(base if isinstance(base, kind) else _blank(kind, node, place), node, place)
    if origin in (Union, types.UnionType):
        return _optional(arguments, node, base, place)
    if origin is tuple:
        return _tuple(arguments, node, place)
    if origin is Literal:
        return _literal(arguments, node, place)
    return _scalar(kind, node, place)


def _blank(kind: type, node: yaml.Node, place: _Place) -> Any:
    """A dataclass of defaults to lay a file's values over where there was None before."""
    try:
        return kind()
    except TypeError as error:
        raise TypeError(f"{place.key}: expected a dataclass whose fields all have defaults, got {kind}") from error


def _optional(arguments: tuple[Any, ...], node: yaml.Node, base: Any, place: _Place) -> Any:
    others = [argument for argument in arguments if argument is not type(None)]
    if len(others) != 1 or len(others) == len(arguments):
        raise TypeError(f"{place.key}: expected a type or None, got a union of {arguments}")
    if _plain_tag(node) == _NULL_TAG:
        return None
    return _value(others[0], node, base, place)


def _tuple(arguments: tuple[Any, ...], node: yaml.Node, place: _Place) -> tuple[Any, ...]:
    if not isinstance(node, yaml.SequenceNode):
        raise place.error(node, f"expected a list, got {_shown(node)}; write [A, B]")
    count = len(node.value)
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        kinds = [arguments[0]] * count
    else:
        kinds = list(arguments)
        if len(kinds) != count:
            raise place.error(node, f"expected {len(kinds)} values, got {count}; write as many as that")
    return tuple(
        _value(kind, element, None, place.element(index))
        for index, (kind, element) in enumerate(zip(kinds, node.value, strict=True))
    )


def _literal(options: tuple[Any, ...], node: yaml.Node, place: _Place) -> Any:
    for option in options:
        if isinstance(option, str):
            if _is_text(node) and node.value == option:
                return option
        elif _plain_tag(node) is not None and node.value == _word(option):
            return option
    shown = ", ".join(_word(option) for option in options)
    near = difflib.get_close_matches(str(node.value), [_word(option) for option in options], n=1)
    mend = f"did you mean '{near[0]}'?" if near else "write one of them"
    raise place.error(node, f"expected one of {shown}, got {_shown(node)}; {mend}")


def _scalar(kind: Any, node: yaml.Node, place: _Place) -> Any:
    text = node.value if isinstance(node, yaml.ScalarNode) else ""
    plain = _plain_tag(node)
    if kind is bool:
        if plain == _BOOL_TAG and text in ("true", "false"):
            return text == "true"
        raise place.error(node, f"expected true or false, got {_shown(node)}; write one of them without quotes")
    if kind is int:
        if plain is not None and _INTEGER.fullmatch(text):
            return int(text.replace("_", ""))
        raise place.error(node, f"expected a whole number, got {_shown(node)}; write one like 12")
    if kind is float:
        if plain is not None and _FLOAT.fullmatch(text):
            return _float(text)
        raise place.error(node, f"expected a number, got {_shown(node)}; write one like 0.5 or 1e-3")
    if kind is str or (isinstance(kind, type) and issubclass(kind, Path)):
        if _is_text(node) and plain not in (_NULL_TAG, _BOOL_TAG):
            return kind(text)
        raise place.error(node, f"expected text, got {_shown(node)}; put it in quotes")
    raise TypeError(f"{place.key}: expected a config type, got {kind}")


def _float(text: str) -> float:
    if text.lower().endswith(".inf"):
        return -math.inf if text.startswith("-") else math.inf
    return float(text.replace("_", ""))


def _plain_tag(node: yaml.Node) -> str | None:
    """What YAML takes an unquoted scalar for; None for quoted ones, collections and explicit tags."""
    if isinstance(node, yaml.ScalarNode) and node.style is None and node.tag in _PLAIN_TAGS:
        return node.tag
    return None


def _is_text(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and (node.tag == _STRING_TAG or _plain_tag(node) is not None)


def _shown(node: yaml.Node) -> str:
    """A value for an error message, on one line and not endless."""
    if not isinstance(node, yaml.ScalarNode):
        return "a list" if isinstance(node, yaml.SequenceNode) else "a mapping"
    if _plain_tag(node) == _NULL_TAG:
        return "null"
    text = " ".join(str(node.value).split())
    text = text if len(text) <= 60 else f"{text[:57]}..."
    return f"{text!r} in quotes" if node.style in ("'", '"') else f"'{text}'"


def _word(option: object) -> str:
    """How an option of a Literal is written in YAML."""
    if option is None or isinstance(option, bool):
        return {None: "null", True: "true", False: "false"}[option]
    return str(option)


def _plain(value: Any) -> Any:
    """Dataclasses as mappings, tuples as lists, paths as text: what YAML knows."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value) if field.init}
    if isinstance(value, (tuple, list)):
        return [_plain(element) for element in value]
    if isinstance(value, Path):
        return str(value)
    return value
