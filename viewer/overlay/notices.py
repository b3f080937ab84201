"""Draws notices over the picture: the message line, which fades, and a bar while a scene or a frame is being read."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.state import ViewerState

MARGIN = 12.0
"""Distance of the notices from the edges of the free area, at a text scale of 1, in window coordinates."""

_LOADING_WIDTH = 280.0
_FLAGS = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.always_auto_resize
    | imgui.WindowFlags_.no_nav
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_focus_on_appearing
)


def draw_notices(state: ViewerState, now: float) -> None:
    """Draw a bar while a scene or a frame is being read, and the message to the user if there is one.

    ``now`` is the time in seconds, from which the message fades.
    """
    session = state.session
    if session.opening is not None:
        work = session.opening_work
        _draw_loading(state, f"Opening {session.opening.name}" + (f": {work}" if work else ""))
    elif session.is_waiting and session.scene is not None:
        work = "Computing" if session.scene.checkpoint else "Reading"
        _draw_loading(state, f"{work} frame {session.playback.frame + 1}", session.scene.computed_share)
    strength = state.notice.strength(session.message, now)
    if strength <= 0:
        session.message = ""
    if session.message:
        _draw_message(state, now, strength)


def _draw_loading(state: ViewerState, label: str, share: float = 0.0) -> None:
    """Draw a bar that shows the share of the work that is done, or moves to and fro if the share is 0: nobody knows how
    long it takes to load torch or to read a file."""
    free, scale = state.layout.free, state.text_scale
    middle, top = imgui.ImVec2(*free.centre), imgui.ImVec2(free.centre[0], free.top + MARGIN * scale)
    # The bar must not hide the subject.
    at, pivot = (top, imgui.ImVec2(0.5, 0)) if state.session.has_frame else (middle, imgui.ImVec2(0.5, 0.5))
    imgui.set_next_window_pos(at, imgui.Cond_.always, pivot)
    imgui.begin("##loading", None, _FLAGS | imgui.WindowFlags_.no_inputs)
    imgui.text(label)
    width = min(_LOADING_WIDTH * scale, max(free.width - 4 * MARGIN * scale, 40))
    # imgui draws a bar that moves to and fro for a negative share.
    imgui.progress_bar(share or -imgui.get_time(), imgui.ImVec2(width, 6 * scale), "")
    imgui.end()


def _draw_message(state: ViewerState, now: float, strength: float) -> None:
    free, margin = state.layout.free, MARGIN * state.text_scale
    imgui.set_next_window_pos(
        imgui.ImVec2(free.centre[0], free.top + free.height - margin), imgui.Cond_.always, imgui.ImVec2(0.5, 1.0)
    )
    width = max(free.width - 2 * margin, 50)
    imgui.set_next_window_size_constraints(imgui.ImVec2(0, 0), imgui.ImVec2(width, max(free.height, 50)))
    imgui.push_style_var(imgui.StyleVar_.alpha, strength)
    imgui.begin("##message", None, _FLAGS)
    imgui.push_text_wrap_pos(max(width - 90 * state.text_scale, 40))
    imgui.text(state.session.message)
    imgui.pop_text_wrap_pos()
    imgui.same_line()
    if imgui.small_button("Close"):
        state.session.message = ""
    if imgui.is_window_hovered():
        state.notice.restart(now)
    imgui.end()
    imgui.pop_style_var()
