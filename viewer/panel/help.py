"""The Controls section, which lists the mouse and keyboard controls."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer import controls
from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState


def _draw(state: ViewerState) -> None:
    for keys, effect in controls.HELP:
        imgui.bullet_text(f"{keys}: {effect}")


HELP = Section("Controls", _draw, needs_scene=False, is_open=False)
