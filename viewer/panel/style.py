"""The Style section: a list of styles, input fields for the chosen style, and the time of the stylizer per image."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import imgui

from fourd.viewer.panel.section import Section
from fourd.viewer.panel.style_fields import edit_style
from fourd.viewer.session import Session
from fourd.viewer.state import ViewerState

_NO_STYLE = "none"


def _draw(state: ViewerState) -> None:
    session = state.session
    _draw_choice(session)
    style = session.settings.style
    if style is None:
        return
    if imgui.button("Save"):
        state.defer(state.save_style)
    imgui.same_line()
    if imgui.button("Reset"):  # choosing the same style reads its file again
        session.choose_style(session.style_name)
    imgui.same_line()
    imgui.text_disabled(f"stylizing: {state.timings.medians()['style']:.1f} ms")

    def report(message: str) -> None:
        session.message = message

    edited = edit_style(session.settings.style or style, report)
    if edited != session.settings.style:
        session.set_style(edited)


def _draw_choice(session: Session) -> None:
    names = session.style_names
    labels = [_NO_STYLE if name is None else Path(name).name for name in names]
    changed, index = imgui.combo("style", names.index(session.style_name), labels)
    if changed:
        session.choose_style(names[index])


STYLE = Section("Style", _draw)
