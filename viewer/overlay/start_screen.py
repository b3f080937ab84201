"""What the window shows while no scene is open: a drop target, buttons that open a scene, and the recent scenes."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import imgui

from fourd.viewer.interface.file_dialog import has_file_dialogs
from fourd.viewer.state import ViewerState

_WIDTH, _TARGET_HEIGHT = 460.0, 130.0
"""Largest width, and height of the drop target, at a text scale of 1, in window coordinates."""
_DASH = 8.0
_FLAGS = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_saved_settings
_INPUT = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all


def draw_start_screen(state: ViewerState) -> None:
    """Draw the start screen in the middle of the free area."""
    free, scale = state.layout.free, state.text_scale
    width = min(_WIDTH * scale, free.width - 24 * scale)
    imgui.set_next_window_pos(imgui.ImVec2(*free.centre), imgui.Cond_.always, imgui.ImVec2(0.5, 0.5))
    imgui.push_style_color(imgui.Col_.window_bg, imgui.ImVec4(0, 0, 0, 0))
    imgui.push_style_color(imgui.Col_.border, imgui.ImVec4(0, 0, 0, 0))
    imgui.begin("##start", None, _FLAGS)
    imgui.pop_style_color(2)
    _draw_drop_target(width, min(_TARGET_HEIGHT * scale, free.height / 3), scale)
    imgui.dummy(imgui.ImVec2(0, 4 * scale))
    _draw_buttons(state, width)
    _draw_recent(state, width, room=free.height - imgui.get_cursor_pos_y() - 40 * scale)
    imgui.end()


def _draw_drop_target(width: float, height: float, scale: float) -> None:
    corner, drawing = imgui.get_cursor_screen_pos(), imgui.get_window_draw_list()
    colour = imgui.get_color_u32(imgui.Col_.text_disabled)
    left, top, right, bottom = corner.x, corner.y, corner.x + width, corner.y + height
    for start, end in (
        ((left, top), (right, top)),
        ((right, top), (right, bottom)),
        ((right, bottom), (left, bottom)),
        ((left, bottom), (left, top)),
    ):
        _draw_dashes(drawing, start, end, colour, scale)
    text = "Drop a .4dv file or a run's folder here"
    size = imgui.calc_text_size(text)
    drawing.add_text(
        imgui.ImVec2((left + right - size.x) / 2, (top + bottom - size.y) / 2),
        imgui.get_color_u32(imgui.Col_.text),
        text,
    )
    imgui.dummy(imgui.ImVec2(width, height))


def _draw_dashes(
    drawing: imgui.ImDrawList, start: tuple[float, float], end: tuple[float, float], colour: int, scale: float
) -> None:
    length = abs(end[0] - start[0]) + abs(end[1] - start[1])
    count = max(int(length / (2 * _DASH * scale)), 1)
    x, y = (end[0] - start[0]) / count, (end[1] - start[1]) / count
    for index in range(count):
        first = imgui.ImVec2(start[0] + (index + 0.25) * x, start[1] + (index + 0.25) * y)
        last = imgui.ImVec2(start[0] + (index + 0.75) * x, start[1] + (index + 0.75) * y)
        drawing.add_line(first, last, colour, max(1.5 * scale, 1.0))


def _draw_buttons(state: ViewerState, width: float) -> None:
    if has_file_dialogs():
        half = (width - imgui.get_style().item_spacing.x) / 2
        if imgui.button("Open a scene...", imgui.ImVec2(half, 0)):
            state.defer(state.choose_file)
        imgui.same_line()
        if imgui.button("Open a run...", imgui.ImVec2(half, 0)):
            state.defer(state.choose_folder)
        return
    button = imgui.calc_text_size("Open").x + 2 * imgui.get_style().frame_padding.x
    imgui.set_next_item_width(width - button - imgui.get_style().item_spacing.x)
    is_entered, state.typed_path = imgui.input_text_with_hint(
        "##path", "path of a .4dv file or of a run", state.typed_path, _INPUT
    )
    imgui.same_line()
    if (imgui.button("Open") or is_entered) and state.typed_path.strip():
        state.open(Path(state.typed_path.strip()).expanduser())


def _draw_recent(state: ViewerState, width: float, room: float) -> None:
    """Draw the recent scenes that are still there, as many as fit into the height ``room``."""
    found = state.recent_scenes()
    lines = int(room / imgui.get_text_line_height_with_spacing()) - 1
    if not found or lines < 1:
        return
    imgui.dummy(imgui.ImVec2(0, 2))
    imgui.text_disabled("Recent")
    for index, path in enumerate(found[:lines]):
        name = f"{path.name}##{index}"
        if imgui.selectable(name, False, 0, imgui.ImVec2(width, 0))[0]:
            state.open(path)
        if imgui.is_item_hovered(imgui.HoveredFlags_.delay_normal):
            imgui.set_tooltip(str(path))
        folder = _shortened(str(path.parent), width / 2)
        imgui.same_line(width - imgui.calc_text_size(folder).x + imgui.get_style().window_padding.x)
        imgui.text_disabled(folder)


def _shortened(text: str, width: float) -> str:
    """Return the end of ``text`` that is at most ``width`` wide."""
    if imgui.calc_text_size(text).x <= width:
        return text
    while len(text) > 1 and imgui.calc_text_size("..." + text).x > width:
        text = text[1:]
    return "..." + text
