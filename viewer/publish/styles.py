"""Writes the styles of the web player as a JSON file, which the code in viewer/web/stylize reads. For each style, the
file contains its shade table (the colours from unlit to lit) and the values of its shader uniforms."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.rendering.ops.stylize.parameters import DETAILS, LINE_FILTERS
from fourd.scene.styles import PRESETS, Style, load_style, view_style
from fourd.scene.styles.presets import STYLE_SUFFIXES
from fourd.scene.styles.tables import make_table

STYLES_NAME = "stylize.json"
NO_STYLE = "none"
_OF_THE_CAMERA = ("ray", "light", "detail_per_depth", "hatch_spacing", "paper")
"""Names of the fields of :class:`fourd.rendering.ops.stylize.parameters.Numbers` (a style's uniforms) that depend on
the camera or on the background colour. The player computes them for each image."""


def load_styles(paths: Iterable[Path]) -> dict[str, Style]:
    """Load the presets and the style files ``paths``. The name of a style file is its file name without suffix.

    Raises:
        UserError: if a file is not a valid style, or if another style has the same name.
    """
    styles = {name: load_style(name) for name in PRESETS}
    for path in paths:
        if path.suffix not in STYLE_SUFFIXES:
            raise UserError(f"--style: expected a .yaml file, got '{path}'; the page always has {', '.join(PRESETS)}")
        if path.stem in styles or path.stem == NO_STYLE:
            raise UserError(f"--style: expected a style with a new name, got '{path}'; rename the file")
        styles[path.stem] = load_style(str(path))
    return styles


def write_styles(path: Path, styles: Mapping[str, Style]) -> None:
    """Write the styles file of the player atomically. Raises UserError if the shade map of a style (the PNG
    from which its shade table is made) cannot be read."""
    with atomic_path(path) as temporary:
        temporary.write_text(encode_styles(styles), encoding="utf-8")


def encode_styles(styles: Mapping[str, Style]) -> str:
    """Return the content of the styles file of the player. Raises UserError, as :func:`write_styles` does."""
    content = {"styles": [_describe(name, style) for name, style in styles.items()]}
    return json.dumps(content, allow_nan=False, separators=(",", ":"))


def _describe(name: str, style: Style) -> dict[str, Any]:
    table = make_table(style)
    # view_style() needs a camera, but the exported numbers must not depend on it. The camera therefore has the axes of
    # the world, so that `light` is not rotated. view_style() divides a constant of the style by the camera's distance
    # from the centre of the scene, and returns the quotient as detail_per_depth. At the distance of 1 unit, it returns
    # the constant itself. This is exported as detail_per_distance, and the player divides it by the actual distance.
    camera = Camera(np.eye(3), np.eye(3), np.zeros(3), 1, 1)
    parameters = view_style(style, table, camera, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    numbers = asdict(parameters.numbers)
    return {
        "name": name,
        "light": numbers["light"],
        "light_frame": style.light.frame,
        "paper": style.paper,
        "persistence": style.persistence,
        "thickness": style.lines.thickness,
        "hatch_spacing": style.hatching.spacing,
        "detail_per_distance": numbers["detail_per_depth"],
        "detail_axis": DETAILS.index(parameters.detail),
        "line_filter": LINE_FILTERS.index(parameters.lines),
        "numbers": {key: value for key, value in numbers.items() if key not in _OF_THE_CAMERA},
        "rows": len(table),
        "table": base64.b64encode(zlib.compress(table.tobytes(), 9)).decode("ascii"),
    }
