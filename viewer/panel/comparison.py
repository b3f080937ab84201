"""The Compare section: how the captured picture is shown, and which capture it is from."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.comparison.comparison import MODES
from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState


def _draw(state: ViewerState) -> None:
    comparison = state.comparison
    changed, index = imgui.combo("captured", MODES.index(comparison.mode), list(MODES))
    if changed:
        state.compare(MODES[index])
    if comparison.folder is not None:
        imgui.text_disabled(comparison.folder.name)
        if imgui.is_item_hovered():
            imgui.set_tooltip(str(comparison.folder))


COMPARISON = Section("Compare", _draw, is_open=False)
