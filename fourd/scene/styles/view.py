"""Converts a style to the stylizer's numeric parameters for one camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.stylize.parameters import MAX_THICKNESS, Numbers, StyleParameters, Triple

if TYPE_CHECKING:
    from fourd.scene.styles.styles import Style

REFERENCE_ROWS = 1080
"""The lengths in a style are in pixels of an image with this number of rows."""


def view_style(
    style: Style,
    table: NDArray[np.uint8],
    camera: Camera,
    focus: Sequence[float] | NDArray[np.floating],
    background: Triple,
) -> StyleParameters:
    """Convert a style to the stylizer's parameters for one image.

    Args:
        table: the style's shade table (:func:`fourd.scene.styles.tables.make_table`).
        camera: the image's pinhole camera.
        focus: (3,) centre of the scene in world units. The style's depths are multiples of the distance from the camera
            to this centre.
        background: red, green and blue behind the scene, which are used if the style has no paper.
    """
    inverse = np.linalg.inv(camera.intrinsics)
    light = np.array(style.light.direction)
    if style.light.frame == "world":
        light = camera.rotation @ light
    unit = max(float(np.linalg.norm(np.asarray(focus) - camera.centre)), 1e-6)
    axis, lines, hatching, angle = style.detail, style.lines, style.hatching, style.angle
    begin = axis.near if axis.by == "depth" else axis.focus
    scale = camera.height / REFERENCE_ROWS
    numbers = Numbers(
        ray=tuple(inverse[:2].ravel() / inverse[2, 2]),
        light=_triple(light / np.linalg.norm(light)),
        **_colour_factors(style),
        detail_offset=-begin / (axis.far - axis.near),
        detail_per_depth=1 / (unit * (axis.far - axis.near)),
        angle_threshold=angle.threshold,
        angle_softness=angle.softness,
        angle_strength=angle.strength if angle.threshold > 0 else 0.0,
        angle_colour=angle.colour,
        depth_threshold=lines.depth,
        normal_threshold=lines.normal,
        line_opacity=lines.opacity,
        line_colour=lines.colour,
        hysteresis=style.hysteresis,
        persistence=style.persistence,
        hatch_spacing=max(hatching.spacing * scale, 3.0),
        hatch_levels=hatching.levels,
        hatch_width=hatching.width,
        hatch_colour=hatching.colour,
        paper=background if style.paper is None else style.paper,
    )
    thickness = min(max(int(lines.thickness * scale + 0.5), 1), MAX_THICKNESS)
    return StyleParameters(numbers, table, axis.by, lines.filter, thickness)


def _colour_factors(style: Style) -> dict[str, float]:
    """Return the factors a, b and c of the colour S * (a + b * F) + c * F, where S is the table's colour and F is the
    captured colour."""
    share, gain = style.albedo, style.ramp.gain
    if style.shading == "none":
        return {"table_alone": 1 - share, "table_times_albedo": 0.0, "albedo_alone": share}
    if style.shading == "gooch":
        return {"table_alone": 1.0, "table_times_albedo": 0.0, "albedo_alone": share}
    return {"table_alone": gain * (1 - share), "table_times_albedo": gain * share, "albedo_alone": 0.0}


def _triple(values: NDArray[np.floating]) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z
