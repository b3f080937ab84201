"""Shade tables, which contain the shading colour for each tone (column) and detail (row): (R, 256, 3) uint8 arrays.
:mod:`fourd.scene.styles.styles` defines tones and details."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.limits import read_limited
from fourd.rendering.ops.stylize.parameters import MAX_ROWS, TONES
from fourd.scene.styles.styles import Ramp, Style

MAX_COLUMNS = 4096
_MAX_MAP_BYTES = 16 << 20
_DETAIL_ROWS = 32


class ShadeMapError(UserError):
    """A style's shade map cannot be read, or does not have the shape that the style needs."""


def make_table(style: Style) -> NDArray[np.uint8]:
    """Make a style's shade table (R, 256, 3) of shading colours. The row depends on the level of detail, and the column
    on the tone (brightness). Raises ShadeMapError if the style's shade map is not a PNG of the right shape."""
    if style.shading == "gooch":
        tones = np.linspace(0, 1, TONES)[:, None]
        return _bytes((1 - tones) * np.array(style.gooch.cool) + tones * np.array(style.gooch.warm))[None]
    if style.shading == "none":
        return np.tile(_bytes(np.array(style.base)), (1, TONES, 1))
    rows = _rows_of_map(style) if style.ramp.map is not None else _rows_of_stops(style)
    if len(rows) > 1 and style.detail.by == "facing" and style.detail.power != 1:
        details = np.linspace(0, 1, MAX_ROWS) ** style.detail.power
        rows = np.stack([_row_at(rows, detail) for detail in details])
    return _bytes(rows)


def read_map(path: Path, most_rows: int) -> NDArray[np.float64]:
    """Read a shade map (rows, columns, 3) with values in [0, 1]. Raises ShadeMapError if the file cannot be read, is
    larger than 16 MiB, or is not a PNG with 1 to ``most_rows`` rows and 2 to 4096 columns."""
    try:
        content = np.frombuffer(read_limited(path, _MAX_MAP_BYTES), np.uint8)
    except UserError as error:
        raise ShadeMapError(str(error)) from error
    except OSError as error:
        raise ShadeMapError(f"{path}: expected a PNG, got '{error.strerror}'; check the path of ramp.map") from error
    is_png = content[:8].tobytes() == b"\x89PNG\r\n\x1a\n"
    shape = tuple(int(side) for side in content[16:24].view(">u4")[::-1]) if is_png and content.size >= 24 else (0, 0)
    if not (1 <= shape[0] <= most_rows and 2 <= shape[1] <= MAX_COLUMNS):
        got = f"{shape[1]} x {shape[0]} pixels" if is_png else "another file"
        rows = "1 row" if most_rows == 1 else f"1 to {most_rows} rows"
        raise ShadeMapError(
            f"{path}: expected a PNG of {rows} and 2 to {MAX_COLUMNS} columns, got {got}; scale the map"
        )
    image = cv2.imdecode(content, cv2.IMREAD_COLOR)
    if image is None:
        raise ShadeMapError(f"{path}: expected a PNG, got a damaged file; write the map again")
    return image[..., ::-1] / 255


def _rows_of_map(style: Style) -> NDArray[np.float64]:
    assert style.ramp.map is not None
    image = read_map(style.ramp.map, 1 if style.shading == "toon" else MAX_ROWS)
    columns = np.minimum(((np.arange(TONES) + 0.5) * image.shape[1] / TONES).astype(int), image.shape[1] - 1)
    return image[:, columns]


def _rows_of_stops(style: Style) -> NDArray[np.float64]:
    first = _blend_stops(style.ramp)[None]
    if style.shading == "toon":
        return first
    share = np.linspace(0, style.detail.fade, _DETAIL_ROWS)[:, None, None]
    if style.detail.by == "facing":
        share = share[::-1]  # at silhouettes, the detail is 0 and the fade colour is used
    return (1 - share) * first + share * np.array(style.detail.fade_colour)


def _blend_stops(ramp: Ramp) -> NDArray[np.float64]:
    tones = np.linspace(0, 1, TONES)
    colours = np.tile(np.array(ramp.stops[0][1:]), (TONES, 1))
    for begin, *colour in ramp.stops[1:]:
        share = np.clip(0.5 + (tones - begin) / max(ramp.softness, 1e-6), 0, 1)[:, None]
        colours = (1 - share) * colours + share * np.array(colour)
    return colours


def _row_at(rows: NDArray[np.float64], detail: float) -> NDArray[np.float64]:
    position = detail * (len(rows) - 1)
    first = min(int(position), len(rows) - 2)
    return rows[first] + (position - first) * (rows[first + 1] - rows[first])


def _bytes(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    return (np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)
