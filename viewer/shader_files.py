"""Reads the GLSL files of viewer/shaders and viewer/web/shaders."""

from __future__ import annotations

import re
from importlib.resources import files

_INCLUDE = re.compile(r'^#include "([\w/.]+)"$', re.MULTILINE)


def read_shader(name: str) -> str:
    """Return the text of a shader file with its included files.

    A name that ends with ".js" is the name of a file in viewer/web/shaders. The window shares these shaders with the
    web player, so they are JavaScript modules, each of which exports one text without placeholders. The text has no
    line ``#version`` and is valid in GLSL 3.30 and in GLSL ES 3.00. All other names are those of files in
    viewer/shaders.
    """
    package = files("fourd.viewer")
    if name.endswith(".js"):
        _, text, _ = (package / "web" / "shaders" / name).read_text().split("`")
        return text
    return _INCLUDE.sub(lambda match: read_shader(match[1]), (package / "shaders" / name).read_text())
