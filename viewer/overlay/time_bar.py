"""The time bar: buttons, a track that shows and sets the time, and the speed."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.overlay.icons import icon_button
from fourd.viewer.playback.clock import SPEEDS, Playback
from fourd.viewer.state import ViewerState

BUTTON = 34.0
"""Width and height of a button at a text scale of 1, in window coordinates."""
MARGIN = 10.0
"""Distance of the buttons from the edges of the window, at a text scale of 1."""

_SPEED_WIDTH = 74.0
_WIDE, _MEDIUM = 800.0, 480.0
"""Widths of the bar from which it shows everything, and from which it shows the time, at a text scale of 1."""
_FLAGS = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_scroll_with_mouse
    | imgui.WindowFlags_.no_bring_to_front_on_focus
    | imgui.WindowFlags_.no_nav
)


def draw_time_bar(state: ViewerState) -> None:
    """Draw the bar along the bottom of the window, and apply the user's changes."""
    bar, scale = state.layout.bar, state.text_scale
    imgui.set_next_window_pos(imgui.ImVec2(bar.left, bar.top))
    imgui.set_next_window_size(imgui.ImVec2(bar.width, bar.height))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
    imgui.push_style_var(
        imgui.StyleVar_.window_padding, imgui.ImVec2(MARGIN * scale, (bar.height - BUTTON * scale) / 2)
    )
    imgui.push_style_var(imgui.StyleVar_.item_spacing, imgui.ImVec2(4 * scale, 0))
    imgui.begin("##bar", None, _FLAGS)
    _draw_widgets(state, bar.width / scale)
    imgui.end()
    imgui.pop_style_var(3)


def time_text(playback: Playback, frame: int, *, has_frame: bool) -> str:
    """Return the time of a frame and the duration in seconds and, if ``has_frame``, the frame's number."""
    seconds = f"{frame / playback.fps:.2f} / {playback.frame_count / playback.fps:.2f} s"
    return f"{seconds}   frame {frame + 1} / {playback.frame_count}" if has_frame else seconds


def _draw_widgets(state: ViewerState, width: float) -> None:
    """Draw the widgets. ``width`` is the width of the bar at a text scale of 1."""
    playback, button, is_wide = state.session.playback, BUTTON * state.text_scale, width >= _WIDE
    gap = imgui.get_style().item_spacing.x
    if is_wide:
        if icon_button("panel", "Panel (Tab)", button, is_on=state.is_panel_open):
            state.toggle_panel()
        imgui.same_line()
    _draw_transport(playback, button)
    widest = imgui.calc_text_size(time_text(playback, playback.frame_count - 1, has_frame=is_wide)).x
    time_width = widest + 4 * gap if width >= _MEDIUM else 0.0
    buttons = 4 if is_wide else 2
    right = time_width + _SPEED_WIDTH * state.text_scale + buttons * (button + gap) + gap
    imgui.same_line()
    track = max(imgui.get_content_region_avail().x - right, button)
    _draw_track(state, track, button)
    imgui.same_line()
    left = imgui.get_cursor_pos_x()
    if time_width:
        _centred_text(time_text(playback, playback.frame, has_frame=is_wide), left + 2 * gap, button)
        imgui.same_line(left + time_width)
    _draw_speed(playback, button, _SPEED_WIDTH * state.text_scale)
    imgui.same_line()
    if icon_button("loop", "Loop (L)", button, is_on=playback.is_looping):
        playback.is_looping = not playback.is_looping
    _draw_window_buttons(state, button, is_wide=is_wide)


def _draw_transport(playback: Playback, button: float) -> None:
    if icon_button("previous", "Previous frame (Left)", button):
        playback.step(-1)
    imgui.same_line()
    if icon_button("pause" if playback.is_playing else "play", "Play or pause (Space)", button):
        playback.toggle()
    imgui.same_line()
    if icon_button("next", "Next frame (Right)", button):
        playback.step(1)


def _draw_window_buttons(state: ViewerState, button: float, *, is_wide: bool) -> None:
    if is_wide:
        imgui.same_line()
        if icon_button("camera", "Save the image (I)", button):
            state.defer(state.take_screenshot)
        imgui.same_line()
        if icon_button("help", "Help (H)", button, is_on=state.is_help_open):
            state.is_help_open = not state.is_help_open
    else:
        imgui.same_line()
        if icon_button("panel", "Panel (Tab)", button, is_on=state.is_panel_open):
            state.toggle_panel()
        return
    imgui.same_line()
    if icon_button("full", "Full screen (F)", button, is_on=state.window.is_full_screen):
        state.defer(state.window.toggle_full_screen)


def _draw_track(state: ViewerState, width: float, height: float) -> None:
    """Draw the track of the time, with the part that is played, the frames that are read, and a knob to drag."""
    session, scale = state.session, state.text_scale
    playback, corner = session.playback, imgui.get_cursor_screen_pos()
    imgui.invisible_button("##time", imgui.ImVec2(width, height))
    is_held, is_hovered = imgui.is_item_active(), imgui.is_item_hovered()
    radius = (7.0 if is_held or is_hovered else 6.0) * scale
    left, right, y = corner.x + radius, corner.x + width - radius, corner.y + height / 2
    last = max(playback.frame_count - 1, 1)
    pointed = round(
        min(max((imgui.get_mouse_pos().x - left) / max(right - left, 1), 0), 1) * (playback.frame_count - 1)
    )
    if is_held:
        playback.is_playing = False
        playback.seek(pointed)
    if is_held or is_hovered:
        imgui.set_tooltip(f"{pointed / playback.fps:.2f} s, frame {pointed + 1}")
    x = left + (right - left) * playback.frame / last
    drawing, half = imgui.get_window_draw_list(), 2 * scale
    _draw_stripe(drawing, (left, right), (y, half), imgui.Col_.frame_bg)
    ahead = 0 if session.scene is None else min(session.scene.frames.frames_ahead, last - playback.frame)
    if playback.direction > 0:
        _draw_stripe(drawing, (x, x + (right - left) * ahead / last), (y, half), imgui.Col_.frame_bg_hovered)
    _draw_stripe(drawing, (left, x), (y, half), imgui.Col_.slider_grab)
    drawing.add_circle_filled(imgui.ImVec2(x, y), radius, imgui.get_color_u32(imgui.Col_.slider_grab))


def _draw_stripe(drawing: imgui.ImDrawList, x: tuple[float, float], y: tuple[float, float], colour: int) -> None:
    """Draw a horizontal stripe between two columns; ``y`` is the middle row and half of the height."""
    upper, lower = imgui.ImVec2(x[0], y[0] - y[1]), imgui.ImVec2(x[1], y[0] + y[1])
    drawing.add_rect_filled(upper, lower, imgui.get_color_u32(colour), y[1])


def _draw_speed(playback: Playback, button: float, width: float) -> None:
    _centre(button, imgui.get_frame_height())
    imgui.set_next_item_width(width)
    if imgui.begin_combo("##speed", f"{playback.speed:g} x", imgui.ComboFlags_.height_largest):
        for speed in SPEEDS:
            if imgui.selectable(f"{speed:g} x", speed == playback.speed)[0]:
                playback.speed = speed
        imgui.end_combo()
    if imgui.is_item_hovered(imgui.HoveredFlags_.delay_normal):
        imgui.set_tooltip("Speed ([ and ])")


def _centred_text(text: str, x: float, button: float) -> None:
    """Draw text at a column of the bar, centred on the buttons. (Widgets after a button draw text lower.)"""
    corner = imgui.get_window_pos()
    y = imgui.get_style().window_padding.y + (button - imgui.get_text_line_height()) / 2
    at = imgui.ImVec2(corner.x + x, round(corner.y + y))
    imgui.get_window_draw_list().add_text(at, imgui.get_color_u32(imgui.Col_.text), text)
    imgui.dummy(imgui.ImVec2(imgui.calc_text_size(text).x, button))


def _centre(button: float, height: float) -> None:
    """Move the next widget down, so that a widget of ``height`` is centred on the buttons."""
    imgui.set_cursor_pos_y(imgui.get_style().window_padding.y + (button - height) / 2)
