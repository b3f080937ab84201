"""The help of commands: ``--help`` lists the options that people use first, and ``--help-all`` lists all options.

Both are generated from the same definitions. An option that only ``--help-all`` lists has the mark RARE in its type.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro


@dataclass(frozen=True)
class Rare:
    """Marks an option that ``--help-all`` lists and ``--help`` does not."""


RARE = Rare()


def help_form(arguments: type, *, is_short: bool) -> type:
    """Return a copy of a dataclass of options, from which tyro makes the help: the docstring of each option is one
    paragraph, because tyro keeps the line breaks of docstrings, and the short help has no rare options."""
    hints = get_type_hints(arguments, include_extras=True)
    docs = _docstrings(arguments)
    annotations: dict[str, Any] = {}
    values: dict[str, Any] = {}
    suppress: Any = tyro.conf.Suppress
    for each in fields(arguments):
        hint = hints[each.name]
        if isinstance(hint, type) and is_dataclass(hint):
            form = help_form(hint, is_short=is_short)
            values |= _default(each, form if each.default_factory is hint else each.default_factory)
            hint = form
        else:
            values |= _default(each, each.default_factory)
        is_hidden = is_short and _is_rare(hint)
        if each.name in docs and not any(getattr(mark, "help", None) for mark in _marks(hint)):
            hint = Annotated[hint, tyro.conf.arg(help=docs[each.name])]
        annotations[each.name] = suppress[hint] if is_hidden else hint
    # tyro finds the description of a group of options by the names of its class.
    names = {name: getattr(arguments, name) for name in ("__module__", "__qualname__", "__doc__")}
    return dataclass(frozen=True)(type(arguments.__name__, (), {**names, "__annotations__": annotations, **values}))


def rare_options(arguments: type) -> Iterator[str]:
    """Yield the names of the fields that the short help leaves out, also of nested dataclasses."""
    for name, hint in get_type_hints(arguments, include_extras=True).items():
        if _is_rare(hint):
            yield name
        elif isinstance(hint, type) and is_dataclass(hint):
            yield from rare_options(hint)


def _is_rare(hint: Any) -> bool:
    return any(isinstance(mark, Rare) for mark in _marks(hint))


def _marks(hint: Any) -> Iterator[Any]:
    """Yield what ``Annotated`` adds to a type."""
    if get_origin(hint) is Annotated:
        inner, *metadata = get_args(hint)
        yield from metadata
        yield from _marks(inner)


def _default(original: Field[Any], factory: Any) -> dict[str, Any]:
    """Return the default of a field as an attribute of a class, or nothing if the field has no default."""
    if factory is not MISSING:
        return {original.name: field(default_factory=factory)}
    return {} if original.default is MISSING else {original.name: original.default}


def _docstrings(arguments: type) -> dict[str, str]:
    """Return the docstring below each field of a class, as one paragraph."""
    [tree] = ast.parse(textwrap.dedent(inspect.getsource(arguments))).body
    assert isinstance(tree, ast.ClassDef)
    found: dict[str, str] = {}
    for above, node in zip(tree.body, tree.body[1:], strict=False):
        if not (isinstance(above, ast.AnnAssign) and isinstance(above.target, ast.Name)):
            continue
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            found[above.target.id] = " ".join(node.value.value.split())
    return found
