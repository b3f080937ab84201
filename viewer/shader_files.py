"""Reads the GLSL files of viewer/shaders. The window and the web player share the shaders of styles."""

from __future__ import annotations

import re
from importlib.resources import files

_INCLUDE = re.compile(r'^#include "([\w/]+\.glsl)"$', re.MULTILINE)


def read_shader(name: str) -> str:
    """Return the text of a shader file with its included files."""
    folder = files("fourd.viewer") / "shaders"
    return _INCLUDE.sub(lambda match: (folder / match[1]).read_text(), (folder / name).read_text())


def read_shader_body(name: str) -> str:
    """Return the text of a shader file without the line ``#version``. The web player adds the line of its own GLSL
    version."""
    text = read_shader(name)
    version, _, body = text.partition("\n")
    return body if version.startswith("#version") else text
