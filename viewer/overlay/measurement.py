"""Draws the measured distance over the picture, and chooses its ends with the mouse."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.base.units import format_length
from fourd.viewer.display import RenderRequest
from fourd.viewer.interface.layout import Area
from fourd.viewer.measuring.pick import pick
from fourd.viewer.overlay.label import draw_label
from fourd.viewer.overlay.views import ShownView, shown_views
from fourd.viewer.state import ViewerState

_LEFT = 0
_MOST_DRAG = 4.0
"""A press that moves the mouse farther than this, in window coordinates, orbits and chooses no place."""
_KNOB_RADIUS = 5.0
_HINT = "click on two points to measure"


def draw_measurement(state: ViewerState) -> None:
    """Draw the ends, the line and its length, and choose an end if the user has clicked on the scene."""
    measurement, session = state.measurement, state.session
    if not measurement.is_on or session.scene is None:
        return
    views = shown_views(state)
    if _is_clicked():
        _choose(state, views)
    if not measurement.places:
        draw_label(state.text_scale, state.rendered_area, _HINT, is_at_bottom=True)
    for view in views:
        _draw_in(state, view, session.scene.manifest.metres_per_unit)


def _is_clicked() -> bool:
    io = imgui.get_io()
    if io.want_capture_mouse or not imgui.is_mouse_released(_LEFT):
        return False
    drag = imgui.get_mouse_drag_delta(_LEFT, 0.0)
    return max(abs(drag.x), abs(drag.y)) <= _MOST_DRAG


def _choose(state: ViewerState, views: tuple[ShownView, ...]) -> None:
    """Choose the place under the mouse, in the scene that is there."""
    mouse, scale = imgui.get_mouse_pos(), state.pixels_per_unit
    view = next((view for view in views if view.area.contains(mouse.x, mouse.y)), None)
    request = None if view is None else _request(state, view)
    if view is None or request is None:
        return
    if view.camera is None:
        state.session.message = "this picture is that of another view: press N or P, or click on the scene"
        return
    place = pick(request.frame, view.camera, (scale * mouse.x, scale * mouse.y), request.manifest.near)
    if place is None:
        state.session.message = "there is no point of the scene: click on the scene"
    else:
        state.measurement.choose(place)


def _request(state: ViewerState, view: ShownView) -> RenderRequest | None:
    """Return what is drawn in a part of the window, or None until it is drawn."""
    other = state.comparison.other
    if view.is_other and other is not None:
        return other.drawn
    return state.session.render_request(state.window.framebuffer_size, shift=state.picture_shift)


def _draw_in(state: ViewerState, view: ShownView, metres_per_unit: float | None) -> None:
    """Draw the line with its ends and its length in a part of the window."""
    measurement, scale = state.measurement, state.text_scale
    ends = [end for end in map(view.in_window, measurement.places) if end is not None]
    with view.clipped(imgui.get_background_draw_list()):
        _draw_line(scale, ends)
    if measurement.length is None or len(ends) < 2:
        return
    x, y = (ends[0].x + ends[1].x) / 2, (ends[0].y + ends[1].y) / 2
    if view.area.contains(x, y):
        beside = Area(x, y - 44 * scale, 300 * scale, 60 * scale)  # above the line
        draw_label(scale, beside, format_length(measurement.length, metres_per_unit, ".3f"))


def _draw_line(scale: float, ends: list[imgui.ImVec2]) -> None:
    drawing = imgui.get_background_draw_list()
    white, black = imgui.IM_COL32(255, 255, 255, 255), imgui.IM_COL32(0, 0, 0, 255)
    if len(ends) == 2:
        drawing.add_line(ends[0], ends[1], black, 4 * scale)
        drawing.add_line(ends[0], ends[1], white, 2 * scale)
    for end in ends:
        drawing.add_circle_filled(end, _KNOB_RADIUS * scale, white)
        drawing.add_circle(end, _KNOB_RADIUS * scale, black, 0, 1.5 * scale)
