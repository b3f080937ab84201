"""The interface of a panel section."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fourd.viewer.state import ViewerState


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
