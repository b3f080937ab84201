"""The interface of a panel section."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fourd.viewer.state import ViewerState

PANEL_WIDTH = 320.0
"""Minimum width of the panel at a text scale of 1, in window coordinates."""


@dataclass(frozen=True)
class Section:
    """A section of the panel.

    Attributes:
        title: title of the collapsible header; empty for a section without a header.
        draw: function that draws the widgets and applies the user's changes.
        needs_scene: whether the section is hidden while no scene is open.
        is_open: whether the section is expanded when the viewer starts.
    """

    title: str
    draw: Callable[[ViewerState], None]
    needs_scene: bool = True
    is_open: bool = True


def text_scale(state: ViewerState) -> float:
    """Return the scale of text and widgets, which is usually the display's scale factor.

    If one window coordinate covers more than one pixel of the framebuffer, the result is 1. Sizes of text and widgets
    are in window coordinates, so on such a display, text is enlarged without an additional scale factor.
    """
    is_scaled = state.window.framebuffer_size[0] > state.window.size[0]
    return 1.0 if is_scaled else state.window.content_scale
