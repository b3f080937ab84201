"""The widgets of the Style section, drawn without a window."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from fourd.scene.styles import PRESETS, Style, load_style
from fourd.scene.styles.styles import DetailAxis, Light, Ramp

imgui = pytest.importorskip("imgui_bundle").imgui


@pytest.fixture(autouse=True)
def context(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A user interface without a window, in which all groups are open."""
    tree_node = imgui.tree_node

    def open_node(title: str) -> bool:
        imgui.set_next_item_open(True)
        return bool(tree_node(title))

    monkeypatch.setattr(imgui, "tree_node", open_node)
    made = imgui.create_context()
    io = imgui.get_io()
    io.set_ini_filename("")
    io.display_size = imgui.ImVec2(800, 3000)
    io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
    yield
    imgui.destroy_context(made)


class Panel:
    """The widgets of a style, and a mouse."""

    def __init__(self, style: Style) -> None:
        self.style = style
        self.messages: list[str] = []

    def draw(self) -> None:
        """Draw one image."""
        from fourd.viewer.panel.style_fields import edit_style

        imgui.new_frame()
        imgui.set_next_window_pos(imgui.ImVec2(0, 0))
        imgui.set_next_window_size(imgui.ImVec2(800, 3000))
        imgui.begin("panel")
        self.style = edit_style(self.style, self.messages.append)
        imgui.end()
        imgui.render()

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press the mouse at ``start``, and release it at ``end``."""
        io = imgui.get_io()
        for position, button in ((start, None), (start, True), (end, None), (end, False)):
            io.add_mouse_pos_event(*position)
            self.draw()
            if button is not None:
                io.add_mouse_button_event(0, button)
                self.draw()


STYLES = {
    **{name: load_style(name) for name in PRESETS},
    "depth": Style("xtoon", detail=DetailAxis(by="depth", near=6.0, far=9.0)),
    "map": Style("toon", ramp=Ramp(map=Path("map.png"))),
    "far light": Style("toon", light=Light((0.0, 1e5, 3.0), "world")),
}


@pytest.mark.parametrize("name", STYLES)
def test_without_input_no_field_changes(name: str) -> None:
    """Catches a slider that rounds or limits the value of a style file when the panel opens."""
    panel = Panel(STYLES[name])
    for _ in range(3):
        panel.draw()
    assert panel.style == STYLES[name]
    assert not panel.messages


@pytest.mark.parametrize("name", STYLES)
def test_no_input_leads_to_an_invalid_style(name: str) -> None:
    """Catches a slider beyond the range of its field, and a group that fails after an input. The test drags the mouse
    from every row of the panel to the left end and to the right end, and types numbers that no field accepts."""
    panel = Panel(STYLES[name])
    io = imgui.get_io()
    seen = {panel.style}
    for row in range(30, 1200, 9):
        for end in (4.0, 796.0):
            panel.drag((300.0, row), (end, row))
            seen.add(panel.style)
    for row in range(30, 1200, 9):
        io.add_key_event(imgui.Key.mod_ctrl, True)
        panel.drag((300.0, row), (300.0, row))
        io.add_key_event(imgui.Key.mod_ctrl, False)
        for text in ("-1e30", "nan"):
            io.add_input_characters_utf8(text)
            panel.draw()
        for pressed in (True, False):
            io.add_key_event(imgui.Key.enter, pressed)
            panel.draw()
        seen.add(panel.style)
    assert len(seen) > 10
    for style in seen:
        assert replace(style) == style  # runs the checks of all fields, and fails for NaN
