"""The progress window shown while a video is written."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import imgui

from fourd.viewer.window import Window

_BAR_WIDTH = 320.0
_FLAGS = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_saved_settings


def draw_progress(window: Window, path: Path, done: int, count: int) -> bool:
    """Draw the progress of a video. Returns True if the user has cancelled the video."""
    width, height = window.size
    imgui.set_next_window_pos(imgui.ImVec2(width / 2, height / 2), imgui.Cond_.always, imgui.ImVec2(0.5, 0.5))
    imgui.begin("##rendering", None, _FLAGS)
    imgui.text(f"Rendering {path}")
    imgui.progress_bar(done / count, imgui.ImVec2(_BAR_WIDTH, 0), f"{done} of {count} images")
    is_cancelled = imgui.button("Stop") or imgui.is_key_pressed(imgui.Key.escape, False)
    imgui.end()
    return is_cancelled
