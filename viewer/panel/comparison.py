"""The Compare section: how a captured picture or another scene is shown, and which capture or scene it is."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import imgui

from fourd.viewer.comparison.comparison import MODES
from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState


def _draw(state: ViewerState) -> None:
    comparison = state.comparison
    changed, index = imgui.combo("compare", MODES.index(comparison.mode), list(MODES))
    if changed:
        state.compare(MODES[index])
    if comparison.other is not None:
        imgui.text_disabled(comparison.other.path.name)
        if imgui.button("Compare with the capture"):
            state.defer(lambda: comparison.set_folder(None))
        return
    is_entered, state.typed_path = imgui.input_text_with_hint(
        "another scene", "path, then Enter", state.typed_path, imgui.InputTextFlags_.enter_returns_true
    )
    if is_entered and state.typed_path.strip():
        path = Path(state.typed_path.strip()).expanduser()
        state.defer(lambda: comparison.set_other(path))
    if comparison.folder is not None:
        imgui.text_disabled(comparison.folder.name)
        if imgui.is_item_hovered():
            imgui.set_tooltip(str(comparison.folder))


COMPARISON = Section("Compare", _draw, is_open=False)
