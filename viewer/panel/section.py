"""The interface of a panel section."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fourd.viewer.state import ViewerState

PANEL_WIDTH = 320.0
"""Minimum width in mouse units at a text scale of 1."""


@dataclass(frozen=True)
class Section:
    """A part of the panel.

    Attributes:
        title: of the collapsible header; empty for a section without one.
        draw: draws the widgets and applies their changes.
        needs_scene: whether the section is hidden while no scene is open.
        is_open: whether it is expanded at first.
    """

    title: str
    draw: Callable[[ViewerState], None]
    needs_scene: bool = True
    is_open: bool = True


def text_scale(state: ViewerState) -> float:
    """The scale of text and widgets: the display's, unless the framebuffer is already larger than the window."""
    is_scaled = state.window.framebuffer_size[0] > state.window.size[0]
    return 1.0 if is_scaled else state.window.content_scale
