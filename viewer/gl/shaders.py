"""Loads, joins and compiles GLSL files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import moderngl

from fourd.rendering.ops.play.op import MIN_TRANSMITTANCE
from fourd.viewer.shader_files import read_shader

TEXELS_PER_ROW = 4096
"""Width in texels of the textures that store arrays. The width is a power of two, so that shaders can use bit
operations."""
MAX_BLENDED = 64
"""Largest number of source views that are blended."""
NONE = 1e9
"""A number larger than every rank. The rank of a disc is its position in depth order, counted from 1 at the nearest
disc.

In depth peeling, a pixel in which a pass finds no disc gets the value NONE. In dual depth peeling, such a pixel gets
-NONE, and NONE is the upper bound of the ranks in the first pass.
"""

_DEFINES = {
    "TEXELS_PER_ROW": str(TEXELS_PER_ROW),
    "MAX_BLENDED": str(MAX_BLENDED),
    "NONE": "1e9",
    "MIN_TRANSMITTANCE": str(MIN_TRANSMITTANCE),
}


def compile_program(
    context: moderngl.Context, vertex: str, fragment: str | None = None, varyings: Sequence[str] = ()
) -> moderngl.Program:
    """Compile the shader files ``vertex`` and ``fragment`` of :func:`fourd.viewer.shader_files.read_shader`.

    ``varyings`` are the names of the outputs that transform feedback captures.
    """
    return context.program(
        vertex_shader=_load_source(vertex),
        fragment_shader=None if fragment is None else _load_source(fragment),
        varyings=tuple(varyings),
    )


def set_uniforms(program: moderngl.Program, **values: Any) -> None:
    """Set uniforms by name, and skip uniforms that the compiler has removed as unused."""
    for name, value in values.items():
        uniform = program.get(name, None)
        if isinstance(uniform, moderngl.Uniform):
            uniform.value = value


def _load_source(name: str) -> str:
    defines = "\n".join(f"#define {key} {value}" for key, value in _DEFINES.items())
    return f"#version 330 core\n{defines}\n{read_shader(name)}"
