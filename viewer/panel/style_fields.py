"""Draws the widgets that change the fields of a style. Each function takes a style, and returns it with the user's
changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, get_args

from imgui_bundle import imgui

from fourd.rendering.ops.stylize.parameters import DETAILS, LINE_FILTERS, MAX_THICKNESS, Triple
from fourd.scene.styles import Style
from fourd.scene.styles.styles import Light, LightFrame, Ramp, ShadingKind, Stop

SHADINGS: tuple[ShadingKind, ...] = get_args(ShadingKind)
_FRAMES: tuple[LightFrame, ...] = get_args(LightFrame)
_MIN_DEPTH_RANGE = 0.01
_Option = TypeVar("_Option", bound=str)


@dataclass(frozen=True)
class Group:
    """A group of widgets that are shown and hidden together.

    Attributes:
        title: title of the group.
        draw: draws the widgets and returns the changed style. Raises ValueError if a value is not valid for the style.
        applies: returns True if the fields of the group have an effect on a given style.
    """

    title: str
    draw: Callable[[Style], Style]
    applies: Callable[[Style], bool] = lambda style: True


def _draw_shading(style: Style) -> Style:
    shading = _combo("shading", style.shading, SHADINGS)
    albedo = _slider("albedo", style.albedo, 0, 1)
    base = _colour("base colour", style.base) if shading == "none" else style.base
    return replace(style, shading=shading, albedo=albedo, base=base)


def _draw_light(style: Style) -> Style:
    light = style.light
    largest = max(1.0, *(abs(value) for value in light.direction))
    shown = [value / largest for value in light.direction]
    changed, values = imgui.slider_float3("direction", shown, -1, 1, "%.2f", imgui.SliderFlags_.always_clamp)
    # A direction of length 0 is not valid, so the last valid direction is kept while all sliders are at 0.
    direction = _triple(values) if changed and any(values) else light.direction
    return replace(style, light=Light(direction, _combo("axes", light.frame, _FRAMES)))


def _draw_ramp(style: Style) -> Style:
    ramp = style.ramp
    gain, softness = _slider("gain", ramp.gain, 0, 3), ramp.softness
    shade_map, stops = ramp.map, ramp.stops
    if shade_map is not None:
        imgui.text_wrapped(f"shade map: {shade_map.name}")
        if imgui.button("Use the stops instead"):
            shade_map = None
    else:
        softness = _slider("softness", softness, 0, 0.5)
        stops = _draw_stops(ramp)
    return replace(style, ramp=Ramp(stops, softness, shade_map, gain))


def _draw_stops(ramp: Ramp) -> tuple[Stop, ...]:
    stops = list(ramp.stops)
    for index, (tone, *colour) in enumerate(stops):
        if index > 0:
            most = stops[index + 1][0] if index + 1 < len(stops) else 1.0
            tone = _slider(f"from tone##{index}", tone, stops[index - 1][0], most)
        red, green, blue = _colour(f"colour {index + 1}", _triple(colour))
        stops[index] = (tone, red, green, blue)
    return tuple(stops)


def _draw_detail(style: Style) -> Style:
    axis = style.detail
    by, near, far, focus, power = axis.by, axis.near, axis.far, axis.focus, axis.power
    by = _combo("detail by", by, DETAILS)
    if by == "facing":
        power = _slider("power", power, 0.1, 8, is_logarithmic=True)
    else:
        near = _slider("near", near, 0, max(far - _MIN_DEPTH_RANGE, 0))
        far = _slider("far", far, near + _MIN_DEPTH_RANGE, max(near + _MIN_DEPTH_RANGE, 5))
        focus = _slider("focus", focus, 0, 5) if by == "focus" else focus
    fade, colour = _slider("fade", axis.fade, 0, 1), _colour("fade colour", axis.fade_colour)
    changed = replace(axis, by=by, near=near, far=far, focus=focus, power=power, fade=fade, fade_colour=colour)
    return replace(style, detail=changed)


def _draw_gooch(style: Style) -> Style:
    gooch = style.gooch
    return replace(style, gooch=replace(gooch, cool=_colour("cool", gooch.cool), warm=_colour("warm", gooch.warm)))


def _draw_lines(style: Style) -> Style:
    lines = style.lines
    kind = _combo("filter", lines.filter, LINE_FILTERS)
    if kind == "none":
        return replace(style, lines=replace(lines, filter=kind))
    return replace(
        style,
        lines=replace(
            lines,
            filter=kind,
            depth=_slider("depth", lines.depth, 0.001, 0.5, "%.3f", is_logarithmic=True),
            normal=_slider("normal", lines.normal, 0.02, 2, is_logarithmic=True),
            thickness=_slider("thickness", lines.thickness, 0.25, MAX_THICKNESS),
            opacity=_slider("strength", lines.opacity, 0, 1),
            colour=_colour("colour", lines.colour),
        ),
        persistence=_slider("persistence", style.persistence, 0, 0.95),
        hysteresis=_slider("hysteresis", style.hysteresis, 0, 0.95),
    )


def _draw_hatching(style: Style) -> Style:
    hatching = style.hatching
    width = _slider("width", hatching.width, 0, 1)
    spacing = _slider("spacing", hatching.spacing, 3, 40)
    first = _slider("first below", hatching.levels[0], 0, 1)
    second = _slider("second below", hatching.levels[1], 0, 1)
    colour = _colour("ink", hatching.colour)
    return replace(
        style, hatching=replace(hatching, width=width, spacing=spacing, levels=(first, second), colour=colour)
    )


def _draw_angle(style: Style) -> Style:
    angle = style.angle
    threshold = _slider("threshold", angle.threshold, 0, 1)
    softness = _slider("softness", angle.softness, 0.001, 0.5, "%.3f")
    strength = _slider("strength", angle.strength, 0, 1)
    colour = _colour("colour", angle.colour)
    changed = replace(angle, threshold=threshold, softness=softness, strength=strength, colour=colour)
    return replace(style, angle=changed)


def _draw_paper(style: Style) -> Style:
    changed, has_paper = imgui.checkbox("instead of the background", style.paper is not None)
    paper = style.paper
    if changed:
        paper = (1.0, 1.0, 1.0) if has_paper else None
    return replace(style, paper=None if paper is None else _colour("paper", paper))


GROUPS: tuple[Group, ...] = (
    Group("Shading", _draw_shading),
    Group("Light", _draw_light, lambda style: style.shading != "none" or style.hatching.width > 0),
    Group("Colours", _draw_ramp, lambda style: style.shading in ("toon", "xtoon")),
    Group("Detail", _draw_detail, lambda style: style.shading == "xtoon"),
    Group("Cool and warm", _draw_gooch, lambda style: style.shading == "gooch"),
    Group("Lines", _draw_lines),
    Group("Hatching", _draw_hatching),
    Group("Grazing angles", _draw_angle),
    Group("Paper", _draw_paper),
)
"""The groups of widgets, from top to bottom."""


def edit_style(style: Style, report: Callable[[str], None]) -> Style:
    """Draw the groups of widgets whose fields have an effect on ``style``. Return the style with the user's changes.

    If there is no input, the result equals ``style`` exactly, because widgets return unchanged values without rounding.

    Args:
        report: receives a one-line message if the user enters a value that is not valid for the style. The group with
            the invalid value keeps its old values.
    """
    for group in GROUPS:
        if not group.applies(style) or not imgui.tree_node(group.title):
            continue
        try:
            style = group.draw(style)
        except ValueError as error:
            report(f"{group.title}: {error}")
        imgui.tree_pop()
    return style


def _slider(
    label: str, value: float, least: float, most: float, shown: str = "%.2f", is_logarithmic: bool = False
) -> float:
    # After Ctrl + click on a slider, the user can type a number, which is clamped to the range of the slider.
    flags = imgui.SliderFlags_.always_clamp | (imgui.SliderFlags_.logarithmic if is_logarithmic else 0)
    changed, found = imgui.slider_float(label, value, least, most, shown, flags)
    return min(max(float(found), least), most) if changed else value


def _colour(label: str, value: Triple) -> Triple:
    changed, found = imgui.color_edit3(label, list(value))
    return _triple([min(max(float(channel), 0.0), 1.0) for channel in found]) if changed else value


def _combo(label: str, value: _Option, options: Sequence[_Option]) -> _Option:
    changed, index = imgui.combo(label, list(options).index(value), list(options))
    return options[index] if changed else value


def _triple(values: Sequence[float]) -> Triple:
    first, second, third = (float(value) for value in values)
    return first, second, third
