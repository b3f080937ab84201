"""The Crop section: a box outside which points are not drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from imgui_bundle import imgui

from fourd.viewer.display import CropBox
from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState

Corner = tuple[float, float, float]
"""A corner of the box in world units."""
_STEPS = 400
"""Number of steps of a slider from the lower to the upper bound of the scene."""
_REACH = 3.0
"""The box can be this much larger than the bounds of the subject, because a background is outside them."""


def _draw(state: ViewerState) -> None:
    scene, session = state.session.scene, state.session
    assert scene is not None
    state.is_box_shown = True
    changed, is_on = imgui.checkbox("hide points outside the box", session.settings.crop is not None)
    if changed:
        crop = CropBox(*_bounds(scene.manifest.bounds)) if is_on else None
        session.settings = replace(session.settings, crop=crop)
    if session.settings.crop is not None:
        bounds, unit = _bounds(scene.manifest.bounds), scene.manifest.metres_per_unit
        session.settings = replace(session.settings, crop=_edit(session.settings.crop, bounds, unit))


def _bounds(bounds: object) -> tuple[Corner, Corner]:
    """Return the corners of the subject's bounds as tuples of numbers."""
    (a, b, c), (d, e, f) = np.asarray(bounds, np.float64).tolist()
    return (a, b, c), (d, e, f)


def _edit(crop: CropBox, bounds: tuple[Corner, Corner], metres_per_unit: float | None) -> CropBox:
    """Draw a pair of numbers for each axis, in metres if the length of a world unit is known. Returns the box with the
    user's changes."""
    scale = metres_per_unit or 1.0
    form = "%.3f" if metres_per_unit is None else "%.3f m"
    low, high = list(crop.lower), list(crop.upper)
    for axis, name in enumerate("xyz"):
        lower, upper = scale * bounds[0][axis], scale * bounds[1][axis]
        extent = max(upper - lower, 1e-6)
        least, most = lower - _REACH * extent, upper + _REACH * extent
        shown = scale * low[axis], scale * high[axis]
        changed, *edited = imgui.drag_float_range2(name, *shown, extent / _STEPS, least, most, form, form)
        if changed:
            low[axis], high[axis] = edited[0] / scale, edited[1] / scale
    return CropBox((low[0], low[1], low[2]), (high[0], high[1], high[2]))


CROP = Section("Crop", _draw, is_open=False)
