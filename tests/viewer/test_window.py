"""The viewer window, controlled by mouse and keys on a virtual screen."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from tests.viewer.scenes import write_shells
from tests.viewer.screen import Screen, Viewer, screen, set_dpi

SIZE = (900, 700)
PANEL_WIDTH, BAR_HEIGHT = 300, 56
PLAY = (103, SIZE[1] - BAR_HEIGHT // 2)
"""Position of the button that plays and pauses."""
BLACK = ("--background", "0", "0", "0")


@pytest.fixture(scope="module")
def display() -> Iterator[Screen]:
    with screen() as made:
        yield made


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "ball.4dv"
    write_shells(path, frames=5)
    return path


@pytest.fixture
def viewer(display: Screen, scene: Path, tmp_path: Path) -> Iterator[Viewer]:
    opened = Viewer(display, tmp_path, str(scene), "--size", str(SIZE[0]), str(SIZE[1]), *BLACK)
    opened.until(lambda: "ball.4dv" in opened.title and shows_scene(opened), "the scene in its window")
    hide_panel(opened)
    yield opened
    assert opened.close() == 0, opened.log
    assert "Traceback" not in opened.log


def hide_panel(viewer: Viewer) -> None:
    assert viewer.picture()[15, 30].any(), "no panel at the upper left"
    viewer.key("Tab")
    viewer.until(lambda: not viewer.picture()[15, 30].any(), "no panel")


def window_image(viewer: Viewer) -> NDArray[np.uint8]:
    """Image (H, W, 3) uint8 of the window above its time bar."""
    return viewer.picture()[: SIZE[1] - BAR_HEIGHT, : SIZE[0]]


def shows_scene(viewer: Viewer) -> bool:
    """Whether something is visible beside the panel."""
    return bool((window_image(viewer)[:, PANEL_WIDTH + 20 :].max(axis=2) > 40).mean() > 0.005)


def stable_image(viewer: Viewer) -> NDArray[np.uint8]:
    """Wait until two consecutive images of the window are equal, and return the image."""
    images = [window_image(viewer)]

    def same_as_before() -> bool:
        time.sleep(0.3)
        images.append(window_image(viewer))
        return np.array_equal(images[-1], images[-2])

    viewer.until(same_as_before, "a stable image")
    return images[-1]


def foreground_share(viewer: Viewer) -> float:
    """Fraction of pixels that differ from the background colour."""
    return float((window_image(viewer).max(axis=2) > 30).mean())


def centre(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Mean position (x, y) of the foreground pixels, or NaN if there are no foreground pixels."""
    rows, columns = np.nonzero(picture.max(axis=2) > 30)
    if not len(rows):
        return np.full(2, np.nan)
    return np.array([columns.mean(), rows.mean()])


def current_frame(viewer: Viewer) -> int:
    return int(viewer.title.split("frame ")[1].split("/")[0])


def pause_at(viewer: Viewer, key: str, frame: int) -> None:
    """Pause playback, and go to the first or last frame with Home or End."""
    viewer.key("space")
    viewer.until(lambda: "paused" in viewer.title, "a pause")
    viewer.key(key)
    viewer.until(lambda: current_frame(viewer) == frame, f"frame {frame}")


def test_it_plays_pauses_and_steps(viewer: Viewer) -> None:
    """Catches keys that have no effect, playback during a pause, and a backward step that does not go from the first to
    the last frame."""
    first = current_frame(viewer)
    viewer.until(lambda: current_frame(viewer) != first, "another frame while it plays")
    pause_at(viewer, "Home", 1)
    viewer.key("Right")
    viewer.until(lambda: current_frame(viewer) == 2, "frame 2")
    viewer.key("Left")
    viewer.key("Left")
    viewer.until(lambda: current_frame(viewer) == 5, "frame 5, by wrapping")
    viewer.key("space")
    viewer.until(lambda: "playing" in viewer.title, "playback")


def test_dragging_orbits_and_pans_and_the_wheel_dollies(viewer: Viewer) -> None:
    """Catches swapped mouse buttons, and a scene that moves in the opposite direction to the mouse."""
    pause_at(viewer, "Home", 1)
    before = stable_image(viewer)
    viewer.drag((600, 350), (700, 380))
    viewer.until(lambda: not np.array_equal(window_image(viewer), before), "another view after a drag")
    orbited = stable_image(viewer)
    assert np.abs(centre(orbited) - centre(before)).max() < 20, "an orbit keeps the object in place"
    viewer.drag((600, 350), (650, 390), button=3)
    viewer.until(
        lambda: np.abs(centre(window_image(viewer)) - centre(orbited) - (50, 40)).max() < 6,
        "the object under the mouse",
    )
    stable_image(viewer)
    area = foreground_share(viewer)
    viewer.screen.xdotool("mousemove", 600, 350, "click", 4, "click", 4)
    viewer.until(lambda: foreground_share(viewer) > 1.2 * area, "a larger object")


def test_held_keys_fly(viewer: Viewer) -> None:
    """Catches keys that have an effect only once, not continuously while they are held down."""
    pause_at(viewer, "Home", 1)
    area = foreground_share(viewer)
    viewer.screen.xdotool("keydown", "w", "sleep", "0.4", "keyup", "w")
    viewer.until(lambda: foreground_share(viewer) > 1.1 * area, "a larger object when flying forward")
    x = centre(stable_image(viewer))[0]
    viewer.screen.xdotool("keydown", "d", "sleep", "0.3", "keyup", "d")
    viewer.until(lambda: centre(window_image(viewer))[0] < x - 5, "the object further left when flying right")


def test_keys_move_to_capture_cameras_and_back(viewer: Viewer) -> None:
    """Catches a transition to a wrong camera, and a key 0 that does not restore the initial view.
    Also catches a bookmark that does not return to its view."""
    pause_at(viewer, "Home", 1)
    viewer.key("0")  # the scene was opened with the panel, beside which it was smaller
    time.sleep(1.0)
    first = stable_image(viewer)
    viewer.key("n")
    viewer.until(lambda: not close(stable_image(viewer), first), "another camera's view")
    viewer.key("0")
    viewer.until(lambda: close(window_image(viewer), first), "the initial view")
    viewer.key("b")
    viewer.key("Escape")  # closes the notice
    viewer.key("n")
    viewer.until(lambda: not close(stable_image(viewer), first), "another camera's view")
    viewer.key("1")
    viewer.until(lambda: close(window_image(viewer), first), "the view of the bookmark")


def close(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    return one.shape == other.shape and float(np.abs(one.astype(float) - other).mean()) < 0.5


def test_all_renderers_show_the_same_image_at_all_sizes(viewer: Viewer) -> None:
    """Catches an image that is flipped or scaled in the window, or keeps the initial size."""
    pause_at(viewer, "Home", 1)
    images = {"cpu": stable_image(viewer)}
    for name in ("sorted", "peel", "dual"):
        viewer.key("r")
        viewer.until(lambda name=name: viewer.title.endswith(f"- {name}"), f"renderer {name}")
        viewer.until(lambda: close(window_image(viewer), images["cpu"]), f"the same image by {name}")
    viewer.screen.xdotool("windowsize", viewer.window, 1100, 500)
    viewer.until(
        lambda: float((viewer.picture()[: 500 - BAR_HEIGHT, :1100].max(axis=2) > 30).mean()) > 0.005, "a picture"
    )
    viewer.until(
        lambda: abs(centre(viewer.picture()[: 500 - BAR_HEIGHT, :1100])[1] - (500 - BAR_HEIGHT) / 2) < 40,
        "the object at the new centre",
    )


def test_a_broken_file_leaves_the_open_scene(viewer: Viewer, tmp_path: Path) -> None:
    """Catches a crash, a missing message, or an empty window after an invalid file is dropped."""
    pause_at(viewer, "Home", 1)
    before = stable_image(viewer)
    broken = tmp_path / "broken.4dv"
    broken.write_bytes(b"PK\x03\x04 but no more")
    viewer.drop(broken)
    message = slice(-60, -5)
    viewer.until(lambda: window_image(viewer)[message].max() > 150, "a message at the bottom")
    viewer.keep("message")
    assert close(window_image(viewer)[: SIZE[1] - 120], before[: SIZE[1] - 120])
    other = tmp_path / "other.4dv"
    write_shells(other, frames=2)
    viewer.drop(other)
    viewer.until(lambda: "other.4dv" in viewer.title and "/2" in viewer.title, "the other scene")


@pytest.mark.parametrize("name", ["sorted", "dual"])
def test_gl_renderers_survive_a_change_of_scene(name: str, viewer: Viewer, scene: Path, tmp_path: Path) -> None:
    """Catches OpenGL objects of the previous scene that are used after they are deleted."""
    other = tmp_path / "other.4dv"
    write_shells(other, frames=2)
    viewer.until(lambda: viewer.key("r") or viewer.title.endswith(f"- {name}"), f"renderer {name}")
    for path in (other, scene, other):
        viewer.drop(path)
        viewer.until(lambda path=path: path.name in viewer.title, path.name)
        viewer.until(lambda: shows_scene(viewer), "the scene")


def test_screenshots_recordings_and_the_last_view(display: Screen, scene: Path, tmp_path: Path) -> None:
    """Catches screenshots that include the panel, and a view that is lost when the window closes."""
    first = Viewer(display, tmp_path, str(scene), "--size", str(SIZE[0]), str(SIZE[1]), *BLACK)
    first.until(lambda: shows_scene(first), "the scene")
    pause_at(first, "Home", 1)
    first.drag((600, 350), (640, 330))
    first.key("F12")
    first.until(lambda: (tmp_path / "ball-001.png").exists(), "a screenshot")
    screenshot = np.asarray(Image.open(tmp_path / "ball-001.png"))
    assert screenshot.shape == (SIZE[1], SIZE[0], 3)
    assert not screenshot[:30, :200].any(), "the screenshot includes the panel"
    hide_panel(first)
    half = BAR_HEIGHT // 2  # the picture is centred in the window above the bar, and in the whole screenshot
    first.until(lambda: close(window_image(first)[:550], screenshot[half : 550 + half]), "the picture of the window")
    first.key("F9")
    first.drag((600, 350), (700, 350))
    first.key("F9")
    first.until(lambda: (tmp_path / "ball-001.path.json").exists(), "a recorded path")
    last_view = stable_image(first)[:550]
    assert first.close() == 0
    again = Viewer(display, tmp_path, str(scene), "--size", str(SIZE[0]), str(SIZE[1]), *BLACK)
    again.until(lambda: shows_scene(again), "the scene")
    hide_panel(again)
    pause_at(again, "Home", 1)
    again.until(lambda: close(window_image(again)[:550], last_view), "the saved view")
    again.key("Tab")
    again.until(lambda: again.picture()[15, 30].any(), "the panel")
    again.click(*PLAY)
    again.until(lambda: "playing" in again.title, "playing, after a click on the bar's button")
    again.key("F10")
    again.until(lambda: not (tmp_path / "ball-001.mp4").exists(), "no video of a path of an earlier session")
    assert again.close() == 0


def test_a_recorded_path_becomes_a_video(viewer: Viewer, tmp_path: Path) -> None:
    """Catches a video with another length than the recorded path, or with another image size than the window."""
    import av

    viewer.key("F9")
    viewer.drag((600, 350), (700, 350))
    viewer.key("F9")
    viewer.until(lambda: (tmp_path / "ball-001.path.json").exists(), "a recorded path")
    viewer.key("F10")
    viewer.until(lambda: (tmp_path / "ball-001.mp4").exists(), "a video")
    with av.open(str(tmp_path / "ball-001.mp4")) as video:
        images = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    text = (tmp_path / "ball-001.path.json").read_text()
    assert len(images) == text.count('"frame"')
    assert images[0].shape == (SIZE[1], SIZE[0], 3)
    assert not np.array_equal(images[0], images[-1])


def test_a_minimised_window_comes_back(viewer: Viewer) -> None:
    """Catches an event loop that fails or stops while the window is hidden."""
    viewer.screen.xdotool("windowunmap", viewer.window)
    viewer.until(lambda: not viewer.screen.xdotool("search", "--onlyvisible", "--name", "^fourd"), "no window")
    viewer.screen.xdotool("windowmap", viewer.window)
    viewer.until(lambda: shows_scene(viewer), "the window again")


def test_a_dense_display_scales_the_panel_and_the_image(scene: Path, tmp_path: Path) -> None:
    """Catches text at half size, and an image at half resolution, on a display scaled to 200%."""
    with screen(2000, 1500) as dense:
        set_dpi(dense.display, 192)
        viewer = Viewer(dense, tmp_path, str(scene), "--size", "900", "700", *BLACK)
        viewer.until(lambda: (viewer.picture()[:1250, 700:1800].max(axis=2) > 40).mean() > 0.005, "the scene")
        viewer.until(lambda: viewer.picture()[15, 590].any(), "a panel of twice the width")
        pause_at(viewer, "Home", 1)
        viewer.key("F12")
        viewer.until(lambda: (tmp_path / "ball-001.png").exists(), "a screenshot")
        assert viewer.close() == 0, viewer.log
    assert Image.open(tmp_path / "ball-001.png").size == (1800, 1400)


@pytest.mark.parametrize("name", ["cpu", "sorted", "peel", "dual"])
def test_opengl_3_3_is_enough(name: str, display: Screen, scene: Path, tmp_path: Path) -> None:
    """Catches OpenGL features of versions above 3.3. Old laptops have OpenGL 3.3, and macOS has OpenGL 4.1."""
    old = {"MESA_GL_VERSION_OVERRIDE": "3.3", "MESA_GLSL_VERSION_OVERRIDE": "330"}
    viewer = Viewer(display, tmp_path, str(scene), "--size", "900", "700", *BLACK, "--renderer", name, variables=old)
    viewer.until(lambda: viewer.title.endswith(f"- {name}") and shows_scene(viewer), "the scene")
    hide_panel(viewer)
    viewer.until(lambda: 0.02 < foreground_share(viewer) < 0.9, "the scene without the panel")
    assert viewer.close() == 0, viewer.log
