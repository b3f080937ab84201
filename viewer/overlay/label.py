"""Draws labels over the picture."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.interface.layout import Area

_MARGIN, _PADDING = 10.0, 6.0
"""Distance from the edges of the area, and around the text, at a text scale of 1."""


def draw_label(scale: float, area: Area, text: str, *, is_at_right: bool = False, is_at_bottom: bool = False) -> None:
    """Draw text in an upper corner or in the middle of the lower edge of an area.

    The text is on a dark ground, so that it is legible on any picture. What is wider than the area is cut off.
    """
    size, margin, padding = imgui.calc_text_size(text), _MARGIN * scale, _PADDING * scale
    width, height = size.x + 2 * padding, size.y + padding
    left, top = area.left + margin, area.top + margin
    if is_at_right:
        left = area.left + area.width - width - margin
    if is_at_bottom:
        left = max(area.centre[0] - width / 2, left)
        top = area.top + area.height - height - margin
    drawing = imgui.get_background_draw_list()
    drawing.push_clip_rect(*corners(area), True)
    drawing.add_rect_filled(*corners(Area(left, top, width, height)), imgui.IM_COL32(0, 0, 0, 170), padding)
    drawing.add_text(imgui.ImVec2(left + padding, top + padding / 2), imgui.IM_COL32(255, 255, 255, 255), text)
    drawing.pop_clip_rect()


def corners(area: Area) -> tuple[imgui.ImVec2, imgui.ImVec2]:
    """Return the upper left and the lower right corner of an area."""
    return imgui.ImVec2(area.left, area.top), imgui.ImVec2(area.left + area.width, area.top + area.height)
