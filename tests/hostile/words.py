"""Random command lines with every option of every command. Option values are out of range or have a wrong type."""

from __future__ import annotations

import dataclasses
import importlib
import os
import typing
from pathlib import Path
from typing import Any

import numpy as np

from fourd.cli.main import COMMANDS

VALUES = (
    "",
    " ",
    "-1",
    "0",
    "1",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "1e400",
    "1e-320",
    "2147483648",
    "9223372036854775808",
    "9" * 5000,
    "1e99999999",
    "1,2,3",
    ":",
    "5:1",
    "::0",
    "0:1:-1",
    "a=b",
    "=",
    "00=1",
    "00=nan",
    "model.hidden=1e9",
    "points=0",
    "seed=-1",
    "true",
    "None",
    "[/x][red]",
    "%s{0}",
    "\x1b]0;hostile\x07",
    "a\nb",
    "\udcff",
    "\u202e",
    "../..",
    "/",
    "/dev/zero",
    "/dev/full",
    "/proc/self/mem",
    ".",
    "~",
    "a" * 300,
    "a" * 200_000,
    "--help-me",
    "-",
    "--",
)
BASES = {
    "make": ("ABSENT", "-o", "OUT.4dv"),
    "calibrate": ("ABSENT", "--board", "ABSENT", "-o", "OUT"),
    "import": ("ABSENT", "OUT"),
    "synth": ("SCENE",),
    "check": ("CAPTURE", "--quick"),
    "matte": ("ABSENT",),
    "carve": ("CAPTURE", "-o", "OUT", "--points", "50", "--workers", "1"),
    "mesh": ("ABSENT", "-o", "OUT"),
    "fit-triangles": ("ABSENT", "-o", "OUT.glb"),
    "train": ("ABSENT", "-o", "OUT", "--max-steps", "0"),
    "eval": ("ABSENT",),
    "export": ("SCENE", "--to", "ply", "-o", "OUT"),
    "pack": ("SCENE", "-o", "OUT.4dv"),
    "edit": ("SCENE", "-o", "OUT.4dv"),
    "render": ("SCENE", "--path", "orbit", "--steps", "1", "--size", "32", "24", "-o", "OUT"),
    "view": ("SCENE", "--renderer", "cpu", "--headless", "OUT.mp4", "--steps", "1", "--size", "32", "24"),
    "web": ("SCENE", "-o", "OUT"),
    "serve": ("ABSENT",),
    "bench": ("ABSENT",),
    "info": ("SCENE",),
    "verify": ("SCENE",),
}
"""Arguments of each command. For commands that would run for a long time, the source is missing."""


class HostileWords:
    """Makes command lines. ``scene`` and ``capture`` are undamaged sources, and ``out`` is the path of the output."""

    def __init__(self, scene: Path, capture: Path, out: Path, rng: np.random.Generator) -> None:
        self._places = {"SCENE": scene, "CAPTURE": capture, "OUT": out, "ABSENT": out.with_name("absent")}
        self._places |= {f"OUT{suffix}": out.with_name(out.name + suffix) for suffix in (".4dv", ".glb", ".mp4")}
        self._rng = rng
        self._options = {name: options_of(name) for name in COMMANDS}

    def next(self) -> tuple[str, ...]:
        """A random command line."""
        rng = self._rng
        name = list(COMMANDS)[rng.integers(len(COMMANDS))]
        words = [str(self._places.get(word, word)) for word in BASES[name]]
        for _ in range(int(rng.integers(1, 4))):
            value = VALUES[rng.integers(len(VALUES))]
            choice = rng.random()
            if choice < 0.75 and self._options[name]:
                option = self._options[name][rng.integers(len(self._options[name]))]
                words += [option, value] if rng.random() < 0.9 else [f"{option}={value}"]
            elif choice < 0.9 and name != "synth":  # synth would write a capture to the changed path
                words[rng.integers(len(words))] = value
            else:
                words.insert(int(rng.integers(len(words) + 1)), value)
        return (name, *words)


def options_of(command: str) -> list[str]:
    """The options of a command, such as ``--max-steps``."""
    return _options(importlib.import_module(f"fourd.cli.{COMMANDS[command]}").Arguments)


def _options(kind: Any) -> list[str]:
    found = []
    for field in dataclasses.fields(kind):
        hint = typing.get_type_hints(kind)[field.name]
        if dataclasses.is_dataclass(hint):
            found += _options(hint)
        else:
            found.append(f"--{field.name.replace('_', '-')}")
    return found


def is_safe(words: tuple[str, ...]) -> bool:
    """Whether a test can run the command line: the command line writes no folder outside the folder of the test."""
    outside = any(words[index] in ("-o", "--out") and _is_outside(words[index + 1]) for index in range(len(words) - 1))
    return not outside and not any(word.startswith("--out=") for word in words)


def _is_outside(path: str) -> bool:
    return path in ("", " ", ".", "/", "../..", "~", "-") or not os.path.isabs(path)
