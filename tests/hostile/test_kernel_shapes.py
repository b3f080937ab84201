"""The docstrings of the native functions have rules for the sizes of arrays, which the kernels' fuzzer needs."""

from __future__ import annotations

import re

from fourd import _native

FUNCTIONS_WITHOUT_SIZES = {"rays_cost", "adam"}
"""Functions whose arrays are results of another function or lists, so their rules are empty."""


def bound_functions(owner: object, prefix: str = "") -> dict[str, tuple[str, str]]:
    """Signature and docstring of all functions and methods that have array parameters, by name."""
    found = {}
    for name, value in vars(owner).items():
        if isinstance(value, type):
            found |= bound_functions(value, f"{name}.")
        elif hasattr(value, "__nb_signature__"):
            signature, docstring, *_ = value.__nb_signature__[0]
            found[prefix + name] = str(signature), str(docstring or "")
    return {name: texts for name, texts in found.items() if "ndarray[" in texts[0].split(") ->")[0]}


def test_every_function_with_arrays_has_rules() -> None:
    """Catches a new kernel that the fuzzer calls with arrays of random sizes, which its binding refuses."""
    functions = bound_functions(_native)
    assert len(functions) > 30
    for name, (_, docstring) in functions.items():
        rules = re.findall(r"^Sizes:(.*)$", docstring, re.M)
        assert rules, name
        assert name in FUNCTIONS_WITHOUT_SIZES or all(rule.strip() for rule in rules), name


def test_rules_name_parameters() -> None:
    """Catches a rule for a parameter that was renamed, which has no effect."""
    for name, (signature, docstring) in bound_functions(_native).items():
        for rule in " ".join(re.findall(r"^Sizes:(.*)$", docstring, re.M)).split():
            parameter = re.split("[=*<]", rule)[0]
            assert re.search(rf"\b{parameter}: ", signature), f"{name}: {rule}"
