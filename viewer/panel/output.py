"""The Output section: screenshots, recorded paths and videos."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState


def _draw(state: ViewerState) -> None:
    if imgui.button("Screenshot"):
        state.defer(state.take_screenshot)
    imgui.same_line()
    _, state.has_alpha = imgui.checkbox("transparent", state.has_alpha)
    if imgui.button("Turntable"):
        state.defer(state.render_turntable)
    if imgui.is_item_hovered(imgui.HoveredFlags_.delay_normal):
        imgui.set_tooltip("Render a turn around the subject to MP4")
    imgui.same_line()
    recorder = state.recorder
    if imgui.button("Record path" if recorder is None else f"Stop ({recorder.seconds:.1f} s)"):
        state.defer(state.toggle_recording)
    if state.recorded_path is not None and imgui.button(f"Render {len(state.recorded_path.samples)} images to MP4"):
        state.defer(state.render_recorded_path)


OUTPUT = Section("Output", _draw)
