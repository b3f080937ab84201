"""Draws the measured distance over the picture, and chooses its ends with the mouse."""

from __future__ import annotations

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.viewer.interface.layout import Area
from fourd.viewer.measuring.pick import pick
from fourd.viewer.overlay.label import draw_label
from fourd.viewer.state import ViewerState

_LEFT = 0
_MOST_DRAG = 4.0
"""A press that moves the mouse farther than this, in window coordinates, orbits and chooses no place."""
_KNOB_RADIUS = 5.0
_HINT = "click on two points to measure"


def draw_measurement(state: ViewerState) -> None:
    """Draw the ends, the line and its length, and choose an end if the user has clicked on the scene."""
    measurement, session = state.measurement, state.session
    if not measurement.is_on or session.scene is None or session.pose is None:
        return
    camera = session.pose.camera(*state.window.framebuffer_size, state.picture_shift)
    if _is_clicked():
        _choose(state, camera)
    if not measurement.places:
        draw_label(state.text_scale, state.rendered_area, _HINT, is_at_bottom=True)
    ends = [end for end in (_in_window(state, camera, place) for place in measurement.places) if end is not None]
    _draw_line(state, ends)
    if measurement.length is not None and len(ends) == 2:
        x, y = (ends[0].x + ends[1].x) / 2, (ends[0].y + ends[1].y) / 2
        beside = Area(x, y - 20 * state.text_scale, 300 * state.text_scale, 60 * state.text_scale)
        draw_label(state.text_scale, beside, f"{measurement.length:.3f}")


def _is_clicked() -> bool:
    io = imgui.get_io()
    if io.want_capture_mouse or not imgui.is_mouse_released(_LEFT):
        return False
    drag = imgui.get_mouse_drag_delta(_LEFT, 0.0)
    return max(abs(drag.x), abs(drag.y)) <= _MOST_DRAG


def _choose(state: ViewerState, camera: Camera) -> None:
    request = state.session.render_request(state.window.framebuffer_size)
    if request is None:
        return
    mouse, scale = imgui.get_mouse_pos(), state.pixels_per_unit
    place = pick(request.frame, camera, (scale * mouse.x, scale * mouse.y), request.manifest.near)
    if place is None:
        state.session.message = "there is no point of the scene: click on the scene"
    else:
        state.measurement.choose(place)


def _in_window(state: ViewerState, camera: Camera, place: NDArray[np.float64]) -> imgui.ImVec2 | None:
    """Return the position of a place in window coordinates, or None if it is behind the camera."""
    pixels, depth = camera.project(place[None])
    if depth[0] <= 0:
        return None
    x, y = pixels[0] / state.pixels_per_unit
    return imgui.ImVec2(float(x), float(y))


def _draw_line(state: ViewerState, ends: list[imgui.ImVec2]) -> None:
    drawing, scale = imgui.get_background_draw_list(), state.text_scale
    white, black = imgui.IM_COL32(255, 255, 255, 255), imgui.IM_COL32(0, 0, 0, 255)
    if len(ends) == 2:
        drawing.add_line(ends[0], ends[1], black, 4 * scale)
        drawing.add_line(ends[0], ends[1], white, 2 * scale)
    for end in ends:
        drawing.add_circle_filled(end, _KNOB_RADIUS * scale, white)
        drawing.add_circle(end, _KNOB_RADIUS * scale, black, 0, 1.5 * scale)
