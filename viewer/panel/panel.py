"""Draws the panel from its sections."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.panel.display import DISPLAY
from fourd.viewer.panel.help import HELP
from fourd.viewer.panel.notices import MARGIN, draw_notices
from fourd.viewer.panel.output import OUTPUT
from fourd.viewer.panel.playback import PLAYBACK
from fourd.viewer.panel.renderer import RENDERER
from fourd.viewer.panel.scene import SCENE
from fourd.viewer.panel.section import PANEL_WIDTH, Section, text_scale
from fourd.viewer.panel.style import STYLE
from fourd.viewer.panel.viewpoint import VIEWPOINT
from fourd.viewer.state import ViewerState

SECTIONS: tuple[Section, ...] = (SCENE, PLAYBACK, VIEWPOINT, DISPLAY, STYLE, OUTPUT, RENDERER, HELP)
"""The sections of the panel, from top to bottom."""

_LABEL_WIDTH = 110.0


def draw_panel(state: ViewerState) -> None:
    """Draw the notices and, if the panel is open, its sections."""
    scale = text_scale(state)
    imgui.get_style().font_scale_dpi = scale
    if state.is_panel_open:
        _draw_sections(state, scale)
    draw_notices(state)


def _draw_sections(state: ViewerState, scale: float) -> None:
    imgui.set_next_window_pos(imgui.ImVec2(MARGIN, MARGIN), imgui.Cond_.first_use_ever)
    height, width = max(state.window.size[1] - 2 * MARGIN, 100.0), scale * PANEL_WIDTH
    imgui.set_next_window_size_constraints(imgui.ImVec2(width, 60), imgui.ImVec2(2 * width, height))
    imgui.begin("fourd", None, imgui.WindowFlags_.always_auto_resize)
    imgui.push_item_width(-_LABEL_WIDTH * scale)
    for section in SECTIONS:
        if section.needs_scene and state.session.scene is None:
            continue
        flags = imgui.TreeNodeFlags_.default_open if section.is_open else 0
        if not section.title or imgui.collapsing_header(section.title, flags):
            section.draw(state)
    imgui.pop_item_width()
    imgui.end()
