"""GLSL files of viewer/shaders, joined and compiled."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import moderngl

from fourd.ops.play.op import MIN_TRANSMITTANCE

TEXELS_A_ROW = 4096
"""Of textures that hold arrays; a power of two."""

_DEFINED = {"TEXELS_A_ROW": str(TEXELS_A_ROW), "NONE": "1e9", "HIDDEN": str(MIN_TRANSMITTANCE)}
_INCLUDE = re.compile(r'^#include "(\w+\.glsl)"$', re.MULTILINE)


def program(
    context: moderngl.Context, vertex: str, fragment: str | None = None, varyings: Sequence[str] = ()
) -> moderngl.Program:
    """Compile the files of these names; ``varyings`` are what transform feedback keeps."""
    return context.program(
        vertex_shader=_source(vertex),
        fragment_shader=None if fragment is None else _source(fragment),
        varyings=tuple(varyings),
    )


def set_uniforms(compiled: moderngl.Program, **values: Any) -> None:
    """Set uniforms by name; those that the compiler has dropped as unused are left out."""
    for name, value in values.items():
        uniform = compiled.get(name, None)
        if isinstance(uniform, moderngl.Uniform):
            uniform.value = value


def _source(name: str) -> str:
    folder = files("fourd.viewer") / "shaders"
    text = _INCLUDE.sub(lambda match: (folder / match[1]).read_text(), (folder / name).read_text())
    version, _, rest = text.partition("\n")
    defines = "\n".join(f"#define {key} {value}" for key, value in _DEFINED.items())
    return f"{version}\n{defines}\n{rest}"
