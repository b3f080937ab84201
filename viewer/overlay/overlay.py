"""Draws the whole user interface over the picture."""

from __future__ import annotations

import time

from fourd.viewer.interface.theme import apply_theme
from fourd.viewer.overlay.comparison import draw_comparison
from fourd.viewer.overlay.crop import draw_crop_box
from fourd.viewer.overlay.help import draw_help
from fourd.viewer.overlay.measurement import draw_measurement
from fourd.viewer.overlay.notices import draw_notices
from fourd.viewer.overlay.start_screen import draw_start_screen
from fourd.viewer.overlay.time_bar import draw_time_bar
from fourd.viewer.panel.panel import draw_panel
from fourd.viewer.state import ViewerState


def draw_overlay(state: ViewerState) -> None:
    """Draw what lies over the picture, the panel, the time bar or the start screen, the help and the notices."""
    apply_theme(state.preferences.theme, state.text_scale)
    if state.session.scene is not None:
        draw_comparison(state)
        draw_measurement(state)
        draw_crop_box(state)
        draw_time_bar(state)
    elif state.session.opening is None:
        draw_start_screen(state)
    if state.is_panel_open:
        draw_panel(state)
    if state.is_help_open:
        draw_help(state)
    draw_notices(state, time.monotonic())
