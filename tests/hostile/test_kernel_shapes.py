"""The rules of the kernels' fuzzer (csrc/fuzz/shapes.h) match the functions of the native module."""

from __future__ import annotations

import re
from pathlib import Path

from fourd import _native

ROOT = Path(__file__).parents[2]
SHAPES = ROOT / "csrc" / "fuzz" / "shapes.h"


def bound_functions(owner: object, prefix: str = "") -> dict[str, str]:
    """The signatures of all functions and methods that have array parameters, by name."""
    found = {}
    for name, value in vars(owner).items():
        if isinstance(value, type):
            found |= bound_functions(value, f"{name}.")
        elif hasattr(value, "__nb_signature__"):
            found[prefix + name] = str(value.__nb_signature__[0][0])
    return {name: signature for name, signature in found.items() if "ndarray[" in signature.split(") ->")[0]}


def read_rules() -> list[tuple[str, str]]:
    """For each entry, the name of the function and its rules."""
    entries = re.findall(r"\{\s*((?:\"[^\"]*\"[\s,]*)+)\}", SHAPES.read_text())
    assert entries
    texts = [re.findall(r"\"([^\"]*)\"", entry) for entry in entries]
    return [(name, "".join(rules)) for name, *rules in texts]


def test_every_function_with_arrays_has_rules() -> None:
    """Catches a new kernel that the fuzzer calls with arrays of random sizes, which its binding refuses."""
    names = {name for name, _ in read_rules()}
    assert names == set(bound_functions(_native))


def test_rules_name_parameters() -> None:
    """Catches a rule for a parameter that was renamed, which has no effect."""
    signatures = bound_functions(_native)
    for name, rules in read_rules():
        for rule in rules.split():
            parameter = re.split("[=*<]", rule)[0]
            assert re.search(rf"\b{parameter}: ", signatures[name]), f"{name}: {rule}"
