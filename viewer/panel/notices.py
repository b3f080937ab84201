"""Draws notices over the image: the message line, and a spinner while a scene or a frame is being read."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.state import ViewerState

MARGIN = 10.0
"""Distance of the notices from the edges of the window, in window coordinates."""

_SPINNER = "|/-\\"
_FLAGS = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_nav


def draw_notices(state: ViewerState) -> None:
    """Draw the spinner while a scene or a frame is being read, and the message to the user if there is one."""
    session = state.session
    if session.is_opening or session.is_waiting:
        _draw_spinner(state, "opening" if session.is_opening else "reading a frame")
    if session.message:
        _draw_message(state)


def _draw_spinner(state: ViewerState, label: str) -> None:
    width, height = state.window.size
    imgui.set_next_window_pos(imgui.ImVec2(width / 2, height / 2), imgui.Cond_.always, imgui.ImVec2(0.5, 0.5))
    imgui.begin("##spinner", None, _FLAGS | imgui.WindowFlags_.no_inputs)
    imgui.text(f"{_SPINNER[int(8 * imgui.get_time()) % len(_SPINNER)]} {label}")
    imgui.end()


def _draw_message(state: ViewerState) -> None:
    width, height = state.window.size
    imgui.set_next_window_pos(imgui.ImVec2(width / 2, height - MARGIN), imgui.Cond_.always, imgui.ImVec2(0.5, 1.0))
    imgui.set_next_window_size_constraints(imgui.ImVec2(0, 0), imgui.ImVec2(max(width - 2 * MARGIN, 50), height))
    imgui.begin("##message", None, _FLAGS)
    imgui.push_text_wrap_pos(max(width - 6 * MARGIN - 80, 40))
    imgui.text(state.session.message)
    imgui.pop_text_wrap_pos()
    imgui.same_line()
    if imgui.small_button("Close"):
        state.session.message = ""
    imgui.end()
