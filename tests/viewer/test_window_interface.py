"""The user interface of the window: its layout, time bar, keys, start screen and screenshots."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.baking.scenes import manifest
from tests.viewer.comparison.captures import RED, write_flat_capture
from tests.viewer.scenes import write_shells
from tests.viewer.screen import Screen, Viewer, screen
from tests.viewer.test_window import (
    BAR_HEIGHT,
    BLACK,
    PANEL_WIDTH,
    SIZE,
    centre,
    current_frame,
    pause_at,
    shows_scene,
    stable_image,
    window_image,
)

SMALL = (640, 400)
TRANSPARENT, SCREENSHOT = (117, 346), (55, 346)
"""Positions of the check box and of the button in the panel's section Output."""


@pytest.fixture(scope="module")
def display() -> Iterator[Screen]:
    with screen() as made:
        yield made


@pytest.fixture
def open_viewer(display: Screen, tmp_path: Path) -> Iterator[Callable[..., Viewer]]:
    """A function that opens the viewer with words of the command line. Windows that a failed test leaves are closed."""
    opened: list[Viewer] = []

    def start(*words: str, variables: dict[str, str] | None = None) -> Viewer:
        opened.append(Viewer(display, tmp_path, *words, variables=variables))
        return opened[-1]

    yield start
    for viewer in opened:
        viewer.process.kill()


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "ball.4dv"
    write_shells(path, frames=5)
    return path


def test_a_small_window_shows_the_subject_in_its_middle(open_viewer: Callable[..., Viewer], scene: Path) -> None:
    """Catches a panel that hides the subject, a picture that the time bar covers, and a picture that is stretched or
    stays behind the panel when the panel opens. Also catches keys that do not close the help or the window."""
    viewer = open_viewer(str(scene), "--size", str(SMALL[0]), str(SMALL[1]), *BLACK)
    height = SMALL[1] - BAR_HEIGHT

    def picture() -> np.ndarray:
        return viewer.picture()[:height, : SMALL[0]]

    viewer.until(lambda: (picture().max(axis=2) > 40).mean() > 0.01, "the scene")
    pause_at(viewer, "Home", 1)
    stable_image(viewer)
    closed = picture()
    assert np.abs(centre(closed) - (SMALL[0] / 2, height / 2)).max() < 5
    viewer.key("Tab")
    free = (SMALL[0] - PANEL_WIDTH) / 2 + PANEL_WIDTH
    viewer.until(lambda: abs(centre(picture()[:, PANEL_WIDTH:])[0] + PANEL_WIDTH - free) < 5, "the picture moved")
    moved, shift = picture(), round(free - SMALL[0] / 2)
    columns = slice(PANEL_WIDTH + 10, SMALL[0])
    expected = closed[:, PANEL_WIDTH + 10 - shift : SMALL[0] - shift]
    assert np.abs(moved[:, columns].astype(float) - expected).mean() < 1
    viewer.key("Escape")
    viewer.until(lambda: not viewer.picture()[15, 30].any(), "no panel")
    viewer.key("F1")
    viewer.until(lambda: picture()[30, 330].any(), "the help")
    viewer.key("Escape")
    viewer.until(lambda: np.array_equal(picture(), closed), "no help")
    viewer.key("ctrl+q")
    assert viewer.process.wait(60) == 0, viewer.log
    viewer.close()


def test_the_time_bar_seeks(open_viewer: Callable[..., Viewer], scene: Path, tmp_path: Path) -> None:
    """Catches a track that does not follow the mouse, and one that ends before the last frame. Also catches a click
    that measures nothing, or at another place."""
    viewer = open_viewer(str(scene), "--size", str(SIZE[0]), str(SIZE[1]), *BLACK)
    viewer.until(lambda: shows_scene(viewer), "the scene")
    y = SIZE[1] - BAR_HEIGHT // 2
    viewer.click(*(490, y))
    viewer.until(lambda: current_frame(viewer) == 5 and "paused" in viewer.title, "the last frame")
    viewer.drag((490, y), (330, y))
    viewer.until(lambda: current_frame(viewer) == 3, "the frame in the middle")
    viewer.key("x")
    middle = ((SIZE[0] + PANEL_WIDTH) // 2, (SIZE[1] - BAR_HEIGHT) // 2)
    for x in (middle[0] - 60, middle[0] + 60):
        viewer.click(x, middle[1])
    viewer.until(lambda: (window_image(viewer)[middle[1], middle[0] - 40 : middle[0]] == 255).all(), "a measured line")
    viewer.key("x")
    viewer.until(lambda: not (window_image(viewer)[middle[1]] == 255).all(axis=1).any(), "no measured line")
    viewer.click(*SCREENSHOT)
    viewer.until(lambda: (tmp_path / "ball-001.png").exists(), "a screenshot")
    viewer.click(*TRANSPARENT)
    viewer.click(*SCREENSHOT)
    viewer.until(lambda: (tmp_path / "ball-002.png").exists(), "a transparent screenshot")
    assert viewer.close() == 0, viewer.log
    plain = np.asarray(Image.open(tmp_path / "ball-001.png")).astype(float)
    cut = np.asarray(Image.open(tmp_path / "ball-002.png")).astype(float)
    assert cut.shape == (SIZE[1], SIZE[0], 4)
    assert not cut[0, 0, 3]
    assert np.abs(cut[..., :3] * cut[..., 3:] / 255 - plain).max() < 4


def test_an_empty_window_opens_scenes(open_viewer: Callable[..., Viewer], scene: Path, tmp_path: Path) -> None:
    """Catches a window that draws nothing without a scene, a typed path that opens nothing, and a scene that could not
    be opened and ends the window. The system has no dialog for files here, so the user types the path."""
    no_dialogs = {"PATH": "/nonexistent"}
    viewer = open_viewer("--size", str(SMALL[0]), str(SMALL[1]), variables=no_dialogs)
    size = (SMALL[1], SMALL[0])
    viewer.until(lambda: (viewer.picture()[: size[0], : size[1]].max(axis=2) > 100).any(), "the drop target")
    time.sleep(1.0)
    viewer.keep("empty")
    for name in ("missing.4dv", scene.name):
        field = (SMALL[0] // 2 - 100, SMALL[1] // 2 + 67)
        viewer.click(*field)
        viewer.screen.xdotool("type", "--delay", "60", name)
        viewer.keep("typed")
        viewer.key("Return")
        time.sleep(1.0)
    viewer.until(lambda: scene.name in viewer.title, "the scene")
    viewer.until(lambda: (window_image(viewer)[: size[0] - BAR_HEIGHT].max(axis=2) > 40).mean() > 0.005, "its picture")
    assert viewer.close() == 0, viewer.log
    assert str(scene) in (tmp_path / "state" / "fourd" / "window.json").read_text()


def test_the_key_v_compares_with_the_captured_picture(
    open_viewer: Callable[..., Viewer], scene: Path, tmp_path: Path
) -> None:
    """Catches a picture on the wrong side of the line or beside its place, a line that does not follow the mouse, and a
    picture that stays after the user has left the view of its camera. Also catches a dropped capture that is not used,
    and a scene without a capture for which nothing happens."""
    capture = write_flat_capture(tmp_path / "recording", manifest(6, 5))
    viewer = open_viewer(str(scene), "--size", str(SMALL[0]), str(SMALL[1]), *BLACK)
    height = SMALL[1] - BAR_HEIGHT

    def picture() -> np.ndarray:
        return viewer.picture()[:height, : SMALL[0]].astype(int)

    def columns(row: int) -> tuple[int, int]:
        """The first and the last column of a row that show the captured picture, or (-1, -1)."""
        found = np.flatnonzero(np.abs(picture()[row] - [*RED[:2], 10]).max(axis=1) < 3)
        return (int(found[0]), int(found[-1])) if len(found) else (-1, -1)

    viewer.until(lambda: (picture().max(axis=2) > 40).mean() > 0.01, "the scene")
    pause_at(viewer, "Home", 1)
    viewer.key("v")
    viewer.until(lambda: picture()[-45:-15].max() > 150, "a notice that there is no capture")
    viewer.drop(capture)
    quarter, half = SMALL[0] // 4, SMALL[0] // 2
    viewer.until(lambda: np.abs(np.array(columns(320)) - (quarter - 160, quarter + 159)).max() < 4, "side by side")
    viewer.key("v")
    edge = (SMALL[0] - height) // 2  # the picture is square, and as high as the free area
    viewer.until(lambda: np.abs(np.array(columns(320)) - (edge, half - 2)).max() < 5, "the picture left of the line")
    assert (picture()[height // 2, half + 20 : half + 60].max(axis=1) > 40).all(), "the scene right of the line"
    viewer.drag((half, height // 2), (half + 100, height // 2))
    viewer.until(lambda: abs(columns(320)[1] - (half + 98)) < 5, "the line under the mouse")
    viewer.drag((half, 300), (half + 60, 300))
    viewer.until(lambda: columns(320) == (-1, -1), "no picture of another view")
    stable_image(viewer)  # a motion of the mouse that is still to come would end the transition
    viewer.key("n")
    viewer.key("p")
    viewer.until(lambda: abs(columns(320)[1] - (half + 98)) < 5, "the picture again")
    viewer.key("v")
    viewer.until(lambda: columns(320) == (-1, -1), "no comparison")
    assert viewer.close() == 0, viewer.log


def test_another_scene_is_shown_from_the_same_view(
    open_viewer: Callable[..., Viewer], scene: Path, tmp_path: Path
) -> None:
    """Catches a second scene that is drawn upside down, from another view or at another frame, and one that lies beside
    the first one where a line divides them. Also catches a click in the left half that measures another place."""
    write_shells(tmp_path / "other.4dv", frames=5)
    words = ("--beside", str(tmp_path / "other.4dv"), "--size", str(SMALL[0]), str(SMALL[1]), *BLACK)
    viewer = open_viewer(str(scene), *words)
    half, rows = SMALL[0] // 2, slice(40, SMALL[1] - BAR_HEIGHT)

    def halves() -> tuple[np.ndarray, np.ndarray]:
        picture = viewer.picture()[rows, : SMALL[0]].astype(float)
        return picture[:, :half], picture[:, half:]

    def are_equal() -> bool:
        left, right = halves()
        return bool(left.max() > 100 and np.abs(left - right).mean() < 0.2)

    viewer.until(are_equal, "the same picture in both halves")
    pause_at(viewer, "End", 5)
    viewer.drag((420, 200), (470, 230))
    stable_image(viewer)
    viewer.until(are_equal, "the same view and frame in both halves")
    viewer.key("x")
    for x in (half // 2 - 40, half + half // 2 + 40):  # the first end on the left, the second one on the right
        viewer.click(x, 172)

    def lines() -> tuple[int, ...]:
        """The lengths of the white lines in the halves."""
        return tuple(int((part == 255).all(axis=2)[172 - 40].sum()) for part in halves())

    viewer.until(lambda: min(lines()) > 60, "a measured line in both halves")
    assert lines()[0] == lines()[1]
    viewer.key("x")
    viewer.key("v")
    viewer.until(lambda: np.median(halves()[0][:, -1]) > 100, "the line")
    divided = stable_image(viewer)
    viewer.key("v")
    viewer.until(lambda: np.median(halves()[0][:, -1]) < 100, "no line")
    whole = stable_image(viewer)
    beside = np.r_[0 : half - 15, half + 15 : SMALL[0]]  # without the line and its knob
    assert np.abs(divided[rows, beside].astype(float) - whole[rows, beside]).mean() < 0.2
    assert viewer.close() == 0, viewer.log
