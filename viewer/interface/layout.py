"""Divides the window into panel, time bar and the free area, in whose centre the picture is."""

from __future__ import annotations

from dataclasses import dataclass

PANEL_WIDTH = 300.0
"""Width of the panel at a text scale of 1, in window coordinates."""
BAR_HEIGHT = 56.0
"""Height of the time bar at a text scale of 1, in window coordinates."""
MIN_FREE_WIDTH = 480.0
"""The panel starts closed if it would leave a narrower free area, at a text scale of 1, in window coordinates."""


@dataclass(frozen=True)
class Area:
    """A rectangle of the window, with row 0 at the top."""

    left: float
    top: float
    width: float
    height: float

    @property
    def centre(self) -> tuple[float, float]:
        """Position (x, y) of the middle."""
        return self.left + self.width / 2, self.top + self.height / 2

    def scaled(self, factor: float) -> Area:
        """Return the area in units that are smaller by ``factor``, such as pixels."""
        return Area(factor * self.left, factor * self.top, factor * self.width, factor * self.height)

    def split(self, share: float) -> tuple[Area, Area]:
        """Return the parts on the left and on the right of a line at ``share`` of the width."""
        width = share * self.width
        left = Area(self.left, self.top, width, self.height)
        return left, Area(self.left + width, self.top, self.width - width, self.height)

    def contains(self, x: float, y: float) -> bool:
        """Return whether a position is in the area."""
        return 0 <= x - self.left < self.width and 0 <= y - self.top < self.height

    def moved(self, right: float) -> Area:
        """Return the area, moved to the right."""
        return Area(self.left + right, self.top, self.width, self.height)


@dataclass(frozen=True)
class Layout:
    """The parts of the window, in window coordinates.

    Attributes:
        size: (width, height) of the window.
        scale: scale of text and widgets.
        has_panel: whether the panel is open.
        has_bar: whether the time bar is visible.
    """

    size: tuple[int, int]
    scale: float
    has_panel: bool
    has_bar: bool

    @property
    def bar(self) -> Area:
        """The time bar, along the bottom of the whole window. Its height is even, and 0 while it is hidden."""
        height = 2 * round(self.scale * BAR_HEIGHT / 2) if self.has_bar else 0
        return Area(0, self.size[1] - height, self.size[0], height)

    @property
    def panel(self) -> Area:
        """The panel, at the left edge above the time bar. Its width is even, and 0 while it is closed."""
        width = 2 * round(self.scale * PANEL_WIDTH / 2) if self.has_panel else 0
        return Area(0, 0, width, self.bar.top)

    @property
    def free(self) -> Area:
        """The area beside the panel and above the time bar. It is at least 1 x 1."""
        left = min(self.panel.width, self.size[0] - 1)
        return Area(left, 0, self.size[0] - left, max(self.bar.top, 1))


def has_room_for_panel(width: float, scale: float) -> bool:
    """Return whether a window of ``width`` has room for the panel and a picture beside it."""
    return width >= scale * (PANEL_WIDTH + MIN_FREE_WIDTH)
