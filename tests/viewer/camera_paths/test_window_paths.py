"""Camera paths in the window, made and played with keys."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.viewer.scenes import write_shells
from tests.viewer.screen import Screen, Viewer, screen
from tests.viewer.test_window import (
    BLACK,
    SIZE,
    close,
    current_frame,
    hide_panel,
    pause_at,
    shows_scene,
    stable_image,
    window_image,
)


@pytest.fixture(scope="module")
def display() -> Iterator[Screen]:
    with screen() as made:
        yield made


def test_keys_add_views_and_play_the_path(display: Screen, tmp_path: Path) -> None:
    """Catches a key without effect, a path that stands still, and one that ends at another view or frame."""
    write_shells(tmp_path / "ball.4dv", 5)
    viewer = Viewer(display, tmp_path, str(tmp_path / "ball.4dv"), "--size", str(SIZE[0]), str(SIZE[1]), *BLACK)
    try:
        viewer.until(lambda: "ball.4dv" in viewer.title and shows_scene(viewer), "the scene in its window")
        hide_panel(viewer)
        pause_at(viewer, "Home", 1)
        viewer.key("k")
        first = window_image(viewer)
        viewer.key("n")
        viewer.key("n")
        viewer.key("End")
        viewer.until(lambda: current_frame(viewer) == 5, "the last frame")
        viewer.until(lambda: not close(window_image(viewer), first), "another view")
        stable_image(viewer)
        viewer.key("k")
        viewer.until(lambda: window_image(viewer)[-60:].max() > 100, "the notice of the key frame")
        viewer.key("Escape")
        last = stable_image(viewer)
        viewer.key("Home")
        viewer.key("0")
        viewer.until(lambda: current_frame(viewer) == 1, "the first frame")
        stable_image(viewer)
        viewer.key("y")
        viewer.until(lambda: current_frame(viewer) == 3, "a frame between the key frames")
        between = window_image(viewer)
        viewer.until(lambda: current_frame(viewer) == 5, "the last key frame")
        assert close(stable_image(viewer), last)
        assert not np.array_equal(between, last)
        assert viewer.close() == 0, viewer.log
    finally:
        viewer.process.kill()
