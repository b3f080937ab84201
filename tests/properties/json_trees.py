"""Generated JSON, and changed copies of valid JSON."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

from hypothesis import strategies as st

Tree = Any

NUMBERS = (0, -1, 1, 255, 256, 65536, 1 << 31, 1 << 63, -(1 << 63), 10**40, 0.0, -0.0, 0.5, -0.5, 1e-320, 1e30, 1e308)
TEXTS = ("", " ", "0", "1e999", "30000/0", "1/3", "../..", "a\nb", "\x1b[2J", "\ud800", "a" * 300, "true", "object")
UNUSUAL: tuple[Tree, ...] = (None, True, False, [], {}, [[]], [{}], {"": None}, [0] * 100, *NUMBERS, *TEXTS)


def trees() -> st.SearchStrategy[Tree]:
    """Any JSON value, without NaN and infinity."""
    leaves = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
    return st.recursive(
        leaves, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner), max_leaves=12
    )


@st.composite
def changed_trees(draw: st.DrawFn, valid: Tree) -> Tree:
    """Copies of ``valid`` with one to three changes. A change replaces a value, removes a key, or repeats an
    element."""
    tree = copy.deepcopy(valid)
    for _ in range(draw(st.integers(1, 3))):
        places = list(_places(tree))
        if not places:
            return copy.deepcopy(draw(st.sampled_from(UNUSUAL)))
        parent, key = places[draw(st.integers(0, len(places) - 1))]
        how = draw(st.sampled_from(("unusual", "any", "remove", "repeat", "scale")))
        # Without the copy, a later change would also modify the list or dictionary in UNUSUAL.
        value = copy.deepcopy(draw(st.sampled_from(UNUSUAL) if how == "unusual" else trees()))
        _change(parent, key, how, value)
    return tree


def _places(tree: Tree) -> Iterator[tuple[Any, Any]]:
    """All positions of values in a tree, as pairs of a container and a key or index."""
    keys = list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        yield tree, key
        yield from _places(tree[key])


def _change(parent: Any, key: Any, how: str, value: Tree) -> None:
    old = parent[key]
    if how == "remove":
        del parent[key]
    elif how == "repeat" and isinstance(parent, list):
        parent.insert(key, copy.deepcopy(old))
    elif how == "scale" and isinstance(old, int | float) and not isinstance(old, bool):
        parent[key] = -2 * old
    else:
        parent[key] = value
