"""The Display section, in which the user sets the number of layers K, point size, density and background."""

from __future__ import annotations

from dataclasses import replace

from imgui_bundle import imgui

from fourd.viewer.display import MAX_SCALE, MIN_SCALE
from fourd.viewer.interface.theme import THEMES
from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState

_MAX_LAYERS = 64


def _draw(state: ViewerState) -> None:
    session = state.session
    settings = session.settings
    changed, layers = imgui.slider_int("layers K", settings.layers, 1, _MAX_LAYERS)
    if changed:
        session.set_layers(layers)
    changed, scale = _scale_slider("point size", settings.point_scale)
    if changed:
        session.settings = replace(session.settings, point_scale=scale)
    changed, scale = _scale_slider("density", settings.density_scale)
    if changed:
        session.settings = replace(session.settings, density_scale=scale)
    changed, colour = imgui.color_edit3("background", list(settings.background))
    if changed:
        red, green, blue = (min(max(float(value), 0.0), 1.0) for value in colour)
        session.settings = session.settings.with_background((red, green, blue))
    theme = state.preferences.theme
    changed, index = imgui.combo("theme", THEMES.index(theme), list(THEMES))
    if changed:
        state.set_preferences(replace(state.preferences, theme=THEMES[index]))


def _scale_slider(label: str, value: float) -> tuple[bool, float]:
    return imgui.slider_float(label, value, MIN_SCALE, MAX_SCALE, "%.2f x", imgui.SliderFlags_.logarithmic)


DISPLAY = Section("Display", _draw, is_open=False)
