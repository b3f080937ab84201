"""The styles that come with fourd, and a loader for style files."""

from __future__ import annotations

from dataclasses import replace
from difflib import get_close_matches
from importlib.resources import as_file, files
from pathlib import Path

from fourd.base.configs import load_overlay
from fourd.base.errors import UserError
from fourd.scene.styles.styles import Style
from fourd.scene.styles.tables import make_table

PRESETS = ("toon", "xtoon", "gooch", "ink")
"""Names of the styles that come with fourd, one YAML file each."""
STYLE_SUFFIXES = (".yaml", ".yml")
"""Suffixes of style files."""


def without_paper(style: Style) -> Style:
    """Return the style with the image's background colour behind the scene, because the user has chosen that colour or
    wants none."""
    return replace(style, paper=None)


def load_style(name: str) -> Style:
    """Load a preset by its name, or a style file. The path of a shade map (see :class:`fourd.scene.styles.styles.Ramp`)
    is relative to the style file.

    Raises:
        UserError: for an unknown name, an unknown key, a value out of range, or a shade map of the wrong shape. The
            message names the file, the line and the key.
    """
    if name in PRESETS:
        with as_file(files("fourd.scene.styles.presets") / f"{name}.yaml") as path:
            return load_overlay(Style(), path)
    path = Path(name)
    if path.suffix not in STYLE_SUFFIXES:
        near = get_close_matches(name, PRESETS, n=1)
        hint = f"did you mean {near[0]}?" if near else "write one of the names or the path of a .yaml file"
        raise UserError(f"--style: expected {', '.join(PRESETS)} or FILE.yaml, got '{name}'; {hint}")
    style = load_overlay(Style(), path)
    if style.ramp.map is not None:
        style = replace(style, ramp=replace(style.ramp, map=path.parent / style.ramp.map))
    make_table(style)  # reports a wrong shade map
    return style
