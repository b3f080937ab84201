"""Convert typed dataclass configs to YAML and back. Unknown keys and wrong types raise errors that name the key.

The type of a config field, and not YAML 1.1's type rules, decides how a YAML scalar is read. For example, ``test_views:
[05, 11]`` gives the names "05" and "11", ``frames: 1:24`` stays text, and ``rate: 1e-3`` is a number. YAML tags cannot
create Python objects.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

import yaml

from fourd.base.errors import UserError, one_line
from fourd.base.files import write_text_atomically
from fourd.base.limits import MAX_CONFIG_BYTES, read_limited

Config = TypeVar("Config")

_INTEGER = re.compile(r"[-+]?[0-9][0-9_]*")
_FLOAT = re.compile(r"[-+]?([0-9][0-9_]*\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)")
_STRING_TAG = "tag:yaml.org,2002:str"
_MAP_TAG = "tag:yaml.org,2002:map"
_NULL_TAG = "tag:yaml.org,2002:null"
_BOOL_TAG = "tag:yaml.org,2002:bool"
_PLAIN_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "timestamp")}


def load_overlay(base: Config, path: Path) -> Config:
    """Return a copy of ``base`` with the values of the YAML file ``path``.

    Fields that are not in the file keep their values.

    Args:
        base: a frozen dataclass instance. Fields may have the types bool, int, float, str, Path and Literal, tuples of
            these types, optional types (``X | None``), and nested dataclasses.
        path: a file with a YAML mapping of field names to values. If the file is empty, ``base`` is returned.

    Raises:
        UserError: the file is missing, the YAML is invalid, a key is unknown or repeated, a value has the wrong type,
            or ``__post_init__`` of the dataclass raises ValueError. The error message names the file, the line and the
            key.
        TypeError: a field of ``base`` has a type that is not supported, which is a bug in the dataclass.
    """
    node = _parse_file(path)
    if node is None:
        return base
    return _overlay(base, node, _Place(str(path), ""))


def set_values(base: Config, assignments: Sequence[str], option: str = "--set") -> Config:
    """Return a copy of ``base`` with values from the command line.

    Fields that no assignment sets keep their values.

    Args:
        base: a frozen dataclass instance, with field types that :func:`load_overlay` supports.
        assignments: strings KEY=VALUE. Dots in KEY separate the names of nested fields. VALUE is YAML. The last
            assignment to a key overrides earlier ones. Values are validated after all assignments are applied.
        option: name of the option, for error messages.

    Raises:
        UserError: an assignment is not KEY=VALUE, a key is unknown, or a value is invalid. The error message names the
            option and the key.
    """
    root = yaml.MappingNode(_MAP_TAG, [])
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals or not all(part.strip() for part in key.split(".")):
            raise UserError(f"{option}: expected KEY=VALUE, got '{assignment}'; write for example rates.planes=1e-3")
        _assign(root, [part.strip() for part in key.split(".")], _parse_value(text, f"{option} {key}"), option)
    return _overlay(base, root, _Place(option, "", has_lines=False))


def assigned_keys(assignments: Sequence[str]) -> set[str]:
    """Return the KEY part of each assignment KEY=VALUE, as given to :func:`set_values`."""
    return {assignment.partition("=")[0].strip() for assignment in assignments}


def to_yaml(config: object) -> str:
    """Convert all fields of a dataclass to YAML text, which :func:`load_overlay` reads back to an equal instance."""
    return yaml.dump(_plain(config), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000)


def save_config(config: object, path: Path) -> None:
    """Write a dataclass as a YAML file, atomically."""
    write_text_atomically(path, to_yaml(config))


@dataclasses.dataclass(frozen=True)
class _Place:
    """The source of a config value, for error messages: a file or an option, and the dotted key."""

    source: str
    key: str
    has_lines: bool = True

    def child(self, name: str) -> _Place:
        return dataclasses.replace(self, key=f"{self.key}.{name}" if self.key else name)

    def element(self, index: int) -> _Place:
        return dataclasses.replace(self, key=f"{self.key}[{index}]")

    def error(self, node: yaml.Node, message: str) -> UserError:
        if not self.has_lines:
            return UserError(f"{self.source}{f' {self.key}' if self.key else ''}: {message}")
        label = f" {self.key}:" if self.key else ""
        return UserError(f"{self.source}, line {node.start_mark.line + 1}:{label} {message}")


MAX_DIGITS = 64
"""Maximum number of characters of an integer in a config, below Python's own limit of 4300 digits."""


class _Dumper(yaml.SafeDumper):
    """A YAML dumper that writes lists on one line, indents mappings, and writes no anchors."""

    def ignore_aliases(self, data: object) -> bool:
        return True


_Dumper.add_representer(list, lambda dumper, data: dumper.represent_sequence("tag:yaml.org,2002:seq", data, True))


def _parse_file(path: Path) -> yaml.Node | None:
    """Parse a YAML file. Return the root of its tree of YAML nodes, or None if the file has no content.

    The nodes are not converted to Python objects, so YAML tags in the file, such as ``!!python/object``, cannot create
    Python objects.
    """
    try:
        text = read_limited(path, MAX_CONFIG_BYTES).decode("utf-8-sig")
    except OSError as error:
        raise UserError(f"{path}: expected a YAML file, got '{error.strerror}'; name a readable file") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: expected UTF-8 text, got invalid UTF-8; save the file as UTF-8") from error
    try:
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f", line {mark.line + 1}" if mark else ""
        raise UserError(f"{path}{line}: expected YAML, got an error: {error.problem}; fix the line") from error
    except (yaml.YAMLError, RecursionError) as error:
        reason = one_line(error)
        raise UserError(f"{path}: expected YAML, got an error: {reason}; fix the file") from error


def read_text_entry(path: Path, key: str) -> str | None:
    """Return the text of a key of the mapping in a YAML file, or None if there is no such text.

    Raises:
        UserError: if the file cannot be read or is not YAML.
    """
    root = _parse_file(path)
    value = _entry(root, key) if isinstance(root, yaml.MappingNode) else None
    return value.value or None if isinstance(value, yaml.ScalarNode) and value.tag == _STRING_TAG else None


def _parse_value(text: str, label: str) -> yaml.Node:
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError) as error:
        raise UserError(f"{label}: expected a YAML value, got '{text}'; put text in quotes") from error
    if node is None:
        raise UserError(f"{label}: expected a value after '=', got none; write null to unset the key")
    return node


def _assign(root: yaml.MappingNode, keys: list[str], value: yaml.Node, option: str) -> None:
    """Set the entry at the path ``keys`` of nested YAML mappings to ``value``."""
    node = root
    for key in keys[:-1]:
        child = _entry(node, key)
        if child is None:
            child = yaml.MappingNode(_MAP_TAG, [])
            node.value.append((yaml.ScalarNode(_STRING_TAG, key, value.start_mark), child))
        if not isinstance(child, yaml.MappingNode):
            raise UserError(f"{option} {'.'.join(keys)}: expected keys below '{key}' or a value, got both; remove one")
        node = child
    node.value = [(name, old) for name, old in node.value if name.value != keys[-1]]
    node.value.append((yaml.ScalarNode(_STRING_TAG, keys[-1], value.start_mark), value))


def _entry(node: yaml.MappingNode, key: str) -> yaml.Node | None:
    return next((value for name, value in node.value if name.value == key), None)


def _overlay(base: Any, node: yaml.Node, place: _Place) -> Any:
    hints = typing.get_type_hints(type(base))
    known = [field.name for field in dataclasses.fields(base) if field.init]
    changes: dict[str, Any] = {}
    nodes: dict[str, yaml.Node] = {}
    for key, value in _entries(node, known, place):
        changes[key] = _value(hints[key], value, getattr(base, key), place.child(key))
        nodes[key] = value
    try:
        return dataclasses.replace(base, **changes)
    except ValueError as error:
        head, _, message = str(error).partition(": ")
        if head in known and message:
            raise place.child(head).error(nodes.get(head, node), f"{message}; change the value") from error
        raise place.error(node, f"{error}; change the value") from error


def _entries(node: yaml.Node, known: list[str], place: _Place) -> list[tuple[str, yaml.Node]]:
    """Return each key of a YAML mapping with its value node. A null node is treated as an empty mapping.

    Raises UserError if a key is unknown or repeated.
    """
    if _plain_tag(node) == _NULL_TAG:
        return []
    if not isinstance(node, yaml.MappingNode):
        raise place.error(
            node, f"expected keys among {', '.join(known)}, got {_describe(node)}; write KEY: VALUE lines"
        )
    seen: dict[str, int] = {}
    entries: list[tuple[str, yaml.Node]] = []
    for key_node, value in node.value:
        key = key_node.value if isinstance(key_node, yaml.ScalarNode) else _describe(key_node)
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            hint = f"did you mean '{near[0]}'?" if near else f"the known keys are {', '.join(known)}"
            raise place.error(key_node, f"expected a known key, got '{key}'; {hint}")
        if key in seen:
            raise place.error(
                key_node, f"expected each key once, got '{key}' also in line {seen[key]}; remove one of them"
            )
        seen[key] = key_node.start_mark.line + 1
        entries.append((key, value))
    return entries


def _value(kind: Any, node: yaml.Node, base: Any, place: _Place) -> Any:
    """Convert a YAML node to the type ``kind``.

    ``base`` is the old value of the config field. If it is a dataclass, fields that the node does not name keep their
    values.
    """
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return _overlay(base if isinstance(base, kind) else _blank(kind, node, place), node, place)
    if origin in (Union, types.UnionType):
        return _optional(arguments, node, base, place)
    if origin is tuple:
        return _tuple(arguments, node, place)
    if origin is Literal:
        return _literal(arguments, node, place)
    return _scalar(kind, node, place)


def _blank(kind: type, node: yaml.Node, place: _Place) -> Any:
    """Make an instance of the dataclass ``kind`` with default values, for a field whose old value is None."""
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
        raise place.error(node, f"expected a list, got {_describe(node)}; write [A, B]")
    count = len(node.value)
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        kinds = [arguments[0]] * count
    else:
        kinds = list(arguments)
        if len(kinds) != count:
            raise place.error(node, f"expected {len(kinds)} values, got {count}; write {len(kinds)} values")
    return tuple(
        _value(kind, element, None, place.element(index))
        for index, (kind, element) in enumerate(zip(kinds, node.value, strict=True))
    )


def _literal(options: tuple[Any, ...], node: yaml.Node, place: _Place) -> Any:
    for option in options:
        if isinstance(option, str):
            if _is_text(node) and node.value == option:
                return option
        elif _plain_tag(node) is not None and node.value == _yaml_word(option):
            return option
    shown = ", ".join(_yaml_word(option) for option in options)
    near = difflib.get_close_matches(_describe(node).strip("'"), [_yaml_word(option) for option in options], n=1)
    hint = f"did you mean '{near[0]}'?" if near else "write one of them"
    raise place.error(node, f"expected one of {shown}, got {_describe(node)}; {hint}")


def _scalar(kind: Any, node: yaml.Node, place: _Place) -> Any:
    text = node.value if isinstance(node, yaml.ScalarNode) else ""
    plain = _plain_tag(node)
    if kind is bool:
        if plain == _BOOL_TAG and text in ("true", "false"):
            return text == "true"
        raise place.error(node, f"expected true or false, got {_describe(node)}; write one of them without quotes")
    if kind is int:
        if plain is not None and len(text) <= MAX_DIGITS and _INTEGER.fullmatch(text):
            return int(text.replace("_", ""))
        raise place.error(node, f"expected a whole number, got {_describe(node)}; write for example 12")
    if kind is float:
        if plain is not None and _FLOAT.fullmatch(text):
            return _float(text)
        raise place.error(node, f"expected a number, got {_describe(node)}; write for example 0.5 or 1e-3")
    if kind is str or (isinstance(kind, type) and issubclass(kind, Path)):
        if _is_text(node) and plain not in (_NULL_TAG, _BOOL_TAG) and "\0" not in text:
            return kind(text)
        raise place.error(node, f"expected text, got {_describe(node)}; put the text in quotes")
    raise TypeError(f"{place.key}: expected a supported field type, got {kind}")


def _float(text: str) -> float:
    if text.lower().endswith(".inf"):
        return -math.inf if text.startswith("-") else math.inf
    return float(text.replace("_", ""))


def _plain_tag(node: yaml.Node) -> str | None:
    """Return the implicit YAML tag of an unquoted scalar, or None for other nodes and explicit tags."""
    if isinstance(node, yaml.ScalarNode) and node.style is None and node.tag in _PLAIN_TAGS:
        return node.tag
    return None


def _is_text(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and (node.tag == _STRING_TAG or _plain_tag(node) is not None)


def _describe(node: yaml.Node) -> str:
    """Format a value for an error message: one line, at most 60 characters."""
    if not isinstance(node, yaml.ScalarNode):
        return "a list" if isinstance(node, yaml.SequenceNode) else "a mapping"
    if _plain_tag(node) == _NULL_TAG:
        return "null"
    text = " ".join(str(node.value).split())
    text = text if len(text) <= 60 else f"{text[:57]}..."
    return f"{text!r} in quotes" if node.style in ("'", '"') else f"'{text}'"


def _yaml_word(option: object) -> str:
    """Return the YAML text of one value of a Literal type."""
    if option is None or isinstance(option, bool):
        return {None: "null", True: "true", False: "false"}[option]
    return str(option)


def _plain(value: Any) -> Any:
    """Convert dataclasses to dicts, tuples to lists, and paths to text."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value) if field.init}
    if isinstance(value, (tuple, list)):
        return [_plain(element) for element in value]
    if isinstance(value, Path):
        return str(value)
    return value
