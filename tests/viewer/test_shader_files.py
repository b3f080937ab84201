"""The GLSL text that the window shares with the web player."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fourd.viewer.shader_files import read_shader

WEB = Path(__file__).parents[2] / "viewer" / "web" / "shaders"


@pytest.mark.parametrize("name", sorted(path.relative_to(WEB).as_posix() for path in WEB.rglob("*.js")))
def test_the_window_reads_the_text_that_the_page_imports(name: str) -> None:
    """Catches a shared file with a placeholder, an escape or more than one text, which only JavaScript would resolve,
    and a version, which only one of both programs accepts."""
    text = read_shader(name)
    assert re.fullmatch(r"export const [A-Z_]+ = /\* glsl \*/ `[^`]+`;\n", (WEB / name).read_text())
    assert not any(part in text for part in ("${", "\\", "#version"))


def test_included_files_are_read() -> None:
    """Catches an include that stays in the text, which drivers refuse."""
    text = read_shader("shade.vert")
    assert "#include" not in text
    assert text.count("vec3 colour_of(vec3 world)") == 1
