"""The Crop section: a box outside which points are not drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from imgui_bundle import imgui

from fourd.viewer.display import CropBox
from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState

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
        lower, upper = _bounds(scene.manifest.bounds)
        session.settings = replace(session.settings, crop=_edit(session.settings.crop, lower, upper))


def _bounds(bounds: object) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return the corners of the subject's bounds as tuples of numbers."""
    (a, b, c), (d, e, f) = np.asarray(bounds, np.float64).tolist()
    return (a, b, c), (d, e, f)


def _edit(crop: CropBox, lower: tuple[float, float, float], upper: tuple[float, float, float]) -> CropBox:
    """Draw a pair of numbers for each axis. Returns the box with the user's changes."""
    low, high = list(crop.lower), list(crop.upper)
    for axis, name in enumerate("xyz"):
        extent = max(upper[axis] - lower[axis], 1e-6)
        least, most = lower[axis] - _REACH * extent, upper[axis] + _REACH * extent
        _, low[axis], high[axis] = imgui.drag_float_range2(
            name, low[axis], high[axis], extent / _STEPS, least, most, "%.3f", "%.3f"
        )
    return CropBox((low[0], low[1], low[2]), (high[0], high[1], high[2]))


CROP = Section("Crop", _draw, is_open=False)
