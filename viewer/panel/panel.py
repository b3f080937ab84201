"""Draws the panel from its sections."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.panel.camera_path import CAMERA_PATH
from fourd.viewer.panel.comparison import COMPARISON
from fourd.viewer.panel.crop import CROP
from fourd.viewer.panel.display import DISPLAY
from fourd.viewer.panel.output import OUTPUT
from fourd.viewer.panel.renderer import RENDERER
from fourd.viewer.panel.scene import SCENE
from fourd.viewer.panel.section import Section
from fourd.viewer.panel.style import STYLE
from fourd.viewer.panel.viewpoint import VIEWPOINT
from fourd.viewer.state import ViewerState

SECTIONS: tuple[Section, ...] = (SCENE, VIEWPOINT, STYLE, OUTPUT, CAMERA_PATH, COMPARISON, CROP, DISPLAY, RENDERER)
"""The sections of the panel, from top to bottom."""

_LABEL_WIDTH = 96.0
_FLAGS = (
    imgui.WindowFlags_.no_title_bar
    | imgui.WindowFlags_.no_resize
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_nav
)


def draw_panel(state: ViewerState) -> None:
    """Draw the panel at the left edge of the window."""
    area, scale = state.layout.panel, state.text_scale
    imgui.set_next_window_pos(imgui.ImVec2(area.left, area.top))
    imgui.set_next_window_size(imgui.ImVec2(area.width, area.height))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
    imgui.begin("fourd", None, _FLAGS)
    imgui.pop_style_var()
    imgui.push_item_width(-_LABEL_WIDTH * scale)
    for section in SECTIONS:
        if section.needs_scene and state.session.scene is None:
            continue
        flags = imgui.TreeNodeFlags_.default_open if section.is_open else 0
        if not section.title or imgui.collapsing_header(section.title, flags):
            section.draw(state)
    imgui.pop_item_width()
    imgui.end()
