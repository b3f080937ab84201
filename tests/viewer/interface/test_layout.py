"""The layout of the window and the fading of notices."""

from __future__ import annotations

from fourd.viewer.interface.layout import Layout, has_room_for_panel
from fourd.viewer.interface.notice_clock import FADE_SECONDS, HOLD_SECONDS, NoticeClock


def test_the_parts_cover_the_window() -> None:
    """Catches a free area that overlaps the panel or the bar, or that leaves a gap."""
    for size, scale in (((1280, 800), 1.0), ((640, 400), 1.0), ((2560, 1440), 2.0), ((901, 701), 1.25)):
        layout = Layout(size, scale, has_panel=True, has_bar=True)
        assert layout.free.left == layout.panel.width
        assert layout.free.left + layout.free.width == size[0]
        assert layout.free.height == layout.panel.height == layout.bar.top
        assert layout.bar.top + layout.bar.height == size[1]


def test_nothing_is_taken_from_an_empty_window() -> None:
    """Catches a start screen that is not in the middle of the window."""
    layout = Layout((640, 400), 1.0, has_panel=False, has_bar=False)
    assert layout.free.centre == (320, 200)


def test_a_tiny_window_has_a_free_area() -> None:
    """Catches a division by zero in a window that is smaller than its panel."""
    free = Layout((100, 40), 2.0, has_panel=True, has_bar=True).free
    assert free.width >= 1
    assert free.height >= 1


def test_only_wide_windows_start_with_the_panel() -> None:
    """Catches a panel that hides the subject in a small window, or in a window on a dense display."""
    assert not has_room_for_panel(640, 1.0)
    assert has_room_for_panel(1280, 1.0)
    assert not has_room_for_panel(1280, 2.0)
    assert has_room_for_panel(2560, 2.0)


def test_notices_fade() -> None:
    """Catches a message that stays, one that vanishes before it can be read, and a new one that starts faded."""
    clock = NoticeClock()
    assert clock.strength("text", 10.0) == 1
    assert clock.strength("text", 10.0 + HOLD_SECONDS) == 1
    end = 10.0 + HOLD_SECONDS + 1.0
    assert clock.is_fading("text", end)
    assert 0 <= clock.strength("text", end + FADE_SECONDS / 2) < 1
    assert clock.strength("text", end + FADE_SECONDS) == 0
    assert clock.strength("another", end) == 1
    assert clock.strength("x" * 200, end) == clock.strength("x" * 200, end + HOLD_SECONDS + 5) == 1
    assert clock.strength("", end) == 0
