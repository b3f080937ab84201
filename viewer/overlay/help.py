"""The help, which lists the mouse and keyboard controls."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.keys import MOUSE, SHORTCUTS
from fourd.viewer.state import ViewerState

_FLAGS = (
    imgui.WindowFlags_.always_auto_resize
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_collapse
    | imgui.WindowFlags_.no_nav
)
ROWS = (*MOUSE, *((shortcut.label, shortcut.effect) for shortcut in SHORTCUTS))
"""The rows of the help: keys, and what they do."""


def draw_help(state: ViewerState) -> None:
    """Draw the help in the middle of the free area. Its close button closes it."""
    free, scale = state.layout.free, state.text_scale
    imgui.set_next_window_pos(imgui.ImVec2(*free.centre), imgui.Cond_.always, imgui.ImVec2(0.5, 0.5))
    largest = imgui.ImVec2(max(free.width - 16 * scale, 100), max(free.height - 16 * scale, 60))
    imgui.set_next_window_size_constraints(imgui.ImVec2(0, 0), largest)
    is_drawn, is_open = imgui.begin("Help", True, _FLAGS)
    state.is_help_open = bool(is_open)
    if is_drawn and imgui.begin_table("keys", 2, imgui.TableFlags_.sizing_fixed_fit):
        for keys, effect in ROWS:
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.text(keys)
            imgui.table_next_column()
            imgui.text_disabled(effect)
        imgui.end_table()
    imgui.end()
