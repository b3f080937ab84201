"""Buttons with icons, which are drawn as shapes so that they are sharp at each scale."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

from imgui_bundle import imgui

IconName = Literal["play", "pause", "previous", "next", "loop", "panel", "help", "full", "camera", "open"]

_SHARE = 0.3
"""Half of the size of an icon as a share of the height of its button."""


def icon_button(icon: IconName, tooltip: str, size: float, *, is_on: bool = False) -> bool:
    """Draw a square button of ``size`` x ``size``. Returns True if the user has pressed it.

    ``is_on`` marks a button whose function is switched on.
    """
    corner = imgui.get_cursor_screen_pos()
    imgui.push_style_color(imgui.Col_.button, imgui.ImVec4(0, 0, 0, 0))
    is_pressed = imgui.button(f"##{icon}", imgui.ImVec2(size, size))
    imgui.pop_style_color()
    if imgui.is_item_hovered(imgui.HoveredFlags_.delay_normal):
        imgui.set_tooltip(tooltip)
    colour = imgui.get_color_u32(imgui.Col_.check_mark if is_on else imgui.Col_.text)
    _DRAWINGS[icon](_Pen(corner.x + size / 2, corner.y + size / 2, _SHARE * size, colour))
    return is_pressed


class _Pen:
    """Draws shapes around a centre. Positions are in units of half of the icon's size, from -1 to 1."""

    def __init__(self, x: float, y: float, unit: float, colour: int) -> None:
        self._centre, self._unit, self._colour = (x, y), unit, colour
        self._list = imgui.get_window_draw_list()
        self._thickness = max(0.22 * unit, 1.0)

    def _at(self, x: float, y: float) -> imgui.ImVec2:
        return imgui.ImVec2(self._centre[0] + self._unit * x, self._centre[1] + self._unit * y)

    def triangle(self, *corners: tuple[float, float]) -> None:
        self._list.add_convex_poly_filled([self._at(*corner) for corner in corners], self._colour)

    def block(self, left: float, top: float, right: float, bottom: float) -> None:
        self._list.add_rect_filled(self._at(left, top), self._at(right, bottom), self._colour, 0.1 * self._unit)

    def line(self, *points: tuple[float, float], is_closed: bool = False) -> None:
        flags = imgui.ImDrawFlags_.closed if is_closed else 0
        self._list.add_polyline([self._at(*point) for point in points], self._colour, self._thickness, flags)

    def arc(self, radius: float, start: float, end: float) -> None:
        """Draw an arc around the centre, between two angles in degrees, clockwise from the right."""
        steps = [math.radians(start + (end - start) * step / 24) for step in range(25)]
        self.line(*((radius * math.cos(angle), radius * math.sin(angle)) for angle in steps))

    def text(self, letter: str) -> None:
        size = imgui.calc_text_size(letter)
        at = imgui.ImVec2(self._centre[0] - size.x / 2, self._centre[1] - size.y / 2)
        self._list.add_text(at, self._colour, letter)


def _play(pen: _Pen) -> None:
    pen.triangle((-0.7, -0.95), (-0.7, 0.95), (0.95, 0))


def _pause(pen: _Pen) -> None:
    pen.block(-0.75, -0.9, -0.2, 0.9)
    pen.block(0.2, -0.9, 0.75, 0.9)


def _next(pen: _Pen) -> None:
    pen.triangle((-0.7, -0.75), (-0.7, 0.75), (0.4, 0))
    pen.block(0.45, -0.75, 0.75, 0.75)


def _previous(pen: _Pen) -> None:
    pen.triangle((0.7, -0.75), (0.7, 0.75), (-0.4, 0))
    pen.block(-0.75, -0.75, -0.45, 0.75)


def _loop(pen: _Pen) -> None:
    pen.arc(0.8, 20, 315)
    pen.triangle((0.92, -0.95), (0.95, -0.15), (0.15, -0.35))


def _panel(pen: _Pen) -> None:
    pen.line((-0.95, -0.75), (0.95, -0.75), (0.95, 0.75), (-0.95, 0.75), is_closed=True)
    pen.block(-0.95, -0.75, -0.35, 0.75)


def _full(pen: _Pen) -> None:
    for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        pen.line((0.9 * x, 0.35 * y), (0.9 * x, 0.9 * y), (0.35 * x, 0.9 * y))


def _camera(pen: _Pen) -> None:
    pen.line((-0.95, -0.5), (0.95, -0.5), (0.95, 0.75), (-0.95, 0.75), is_closed=True)
    pen.arc(0.35, 0, 360)
    pen.block(-0.35, -0.8, 0.35, -0.5)


def _open(pen: _Pen) -> None:
    pen.line((-0.95, 0.7), (-0.95, -0.7), (-0.3, -0.7), (0, -0.4), (0.95, -0.4), (0.95, 0.7), is_closed=True)


_DRAWINGS: dict[IconName, Callable[[_Pen], None]] = {
    "play": _play,
    "pause": _pause,
    "previous": _previous,
    "next": _next,
    "loop": _loop,
    "panel": _panel,
    "help": lambda pen: pen.text("?"),
    "full": _full,
    "camera": _camera,
    "open": _open,
}
