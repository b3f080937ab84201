"""Tests of what users do with the web player (play, seek, move, share a link, resize), and of a lost WebGL context."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage


def test_it_plays_loops_and_pauses(open_page: Callable[..., PlayerPage], object_site: Path) -> None:
    """Catches playback that does not start, does not loop or does not pause."""
    with serving(object_site) as server:
        page = open_page(server.url)
        page.ready()
        page.run("window.seen = []; stage.clock.speed = 4;")
        page.wait("(window.seen.push(stage.clock.frame), new Set(window.seen).size >= 3)")
        page.wait("window.seen.at(-1) > stage.clock.frame || (window.seen.push(stage.clock.frame), false)")
        page.page.keyboard.press("Tab")
        page.run("player.focus();")
        page.page.keyboard.press("Space")
        assert page.run("return stage.clock.isPlaying;") is False
        assert page.page.title() == 'A <scene> & "more"'
    assert page.problems == []


def test_keys_and_the_time_bar_select_frames(play: PlayerPage) -> None:
    """Catches keys without effect, or that have an effect only after a click on the page, and a time bar that shows
    another frame than the image."""
    for key, frame in (("End", 5), ("ArrowRight", 0), ("ArrowRight", 1), ("Home", 0), ("ArrowLeft", 5)):
        play.page.keyboard.press(key)
        play.run("await player.settled();")
        assert play.run("return [stage.order.frame, Number(player.panel.scrub.value)];") == [frame, frame]
    assert play.run("return player.panel.time.textContent;") == "0.21 / 0.25 s"
    play.run(
        "player.panel.scrub.value = 3; player.panel.scrub.dispatchEvent(new Event('input')); await player.settled();"
    )
    assert play.run("return stage.order.frame;") == 3


def test_each_key_of_the_help_has_its_effect(play: PlayerPage) -> None:
    """Catches a key of the help that does nothing in a browser, where its code differs from the letter on it."""
    play.wait("!player.panel.styles.hidden")

    def becomes(key: str, condition: str) -> None:
        play.page.keyboard.press(key)
        play.wait(condition)

    for key in ("?", "h", "F1"):
        becomes(key, "!player.panel.help.hidden")
        becomes("Escape" if key == "?" else key, "player.panel.help.hidden")
    becomes("t", "player.panel.styles.value === 'toon'")
    becomes("[", "stage.clock.speed === 0.5")
    becomes("]", "stage.clock.speed === 1")
    becomes("l", "!stage.clock.loops")
    becomes("n", "player.panel.camera.value === '0'")
    becomes("n", "player.panel.camera.value === '1'")
    becomes("p", "player.panel.camera.value === '0'")
    becomes("Space", "stage.clock.isPlaying")
    becomes("c", "location.hash.includes('t=')")
    becomes("f", "document.fullscreenElement === player")
    becomes("f", "document.fullscreenElement === null")
    with play.page.expect_download():
        play.page.keyboard.press("i")


def test_mouse_wheel_and_keys_move_the_view(play: PlayerPage) -> None:
    """Catches a drag, a mouse wheel or a key that has no effect on the view."""
    start = play.run("return stage.pose;")
    mouse = play.page.mouse
    mouse.move(40, 30)
    mouse.down()
    mouse.move(60, 35)
    mouse.up()
    orbited = play.run("return stage.pose;")
    assert np.abs(np.subtract(orbited["rotation"], start["rotation"])).max() > 0.1
    assert orbited["pivot"] == start["pivot"]
    mouse.wheel(0, -100)
    play.wait(f"Math.abs(stage.pose.distance / {start['distance']} - 0.9) < 1e-6")
    mouse.down(button="right")
    mouse.move(70, 35)
    mouse.up(button="right")
    assert play.run("return stage.pose;")["pivot"] != start["pivot"]
    moved = play.run("return stage.pose.pivot;")
    play.page.keyboard.down("w")
    play.wait(f"stage.pose.pivot.some((value, i) => Math.abs(value - {moved}[i]) > 1e-4)")
    play.page.keyboard.up("w")
    play.page.keyboard.press("0")
    assert play.run("await player.settled(); return stage.pose;") == start


def test_touch_moves_the_view(open_page: Callable[..., PlayerPage], object_site: Path) -> None:
    """Catches touch gestures that scroll or zoom the page instead of moving the view of the scene."""
    with serving(object_site) as server:
        page = open_page(server.url, has_touch=True)
        page.pause(0)
        session = page.page.context.new_cdp_session(page.page)

        def touch(kind: str, *points: tuple[int, int]) -> None:
            described = [{"x": x, "y": y, "id": index} for index, (x, y) in enumerate(points)]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": described})

        start = page.run("return stage.pose;")
        touch("touchStart", (40, 30))
        touch("touchMove", (60, 30))
        touch("touchEnd")
        orbited = page.run("return stage.pose;")
        assert orbited["rotation"] != start["rotation"]
        touch("touchStart", (40, 30), (50, 30))
        touch("touchMove", (30, 30), (60, 30))
        touch("touchEnd")
        assert page.run("return stage.pose.distance;") < 0.6 * start["distance"]


def test_the_image_follows_the_size_of_the_page(play: PlayerPage) -> None:
    """Catches an image that is stretched after the window was resized."""
    play.page.set_viewport_size({"width": 160, "height": 80})
    play.wait("player.panel.canvas.width === 160 && player.panel.canvas.height === 80")
    play.run("await player.settled();")
    assert play.run("return [stage.camera(1).width, stage.camera(1).height];") == [160, 80]


def test_a_link_holds_view_and_time(play: PlayerPage, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a link that opens the wrong view or frame, and a damaged link that stops the page."""
    play.run("player.moveToCamera(2); player.seek(4);")
    play.run("const {orbit} = await import('/player/navigate/pose.js'); stage.setPose(orbit(stage.pose, 0.4, 0.1));")
    link, pose = play.run("return [player.shareLink, stage.pose];")
    other = open_page(link)
    other.ready()
    other.run("stage.clock.isPlaying = false;")
    got = other.run("return stage.pose;")
    for name in ("pivot", "rotation", "distance", "fieldOfView", "offset"):
        np.testing.assert_allclose(got[name], pose[name], atol=1e-5)
    assert "t=0.167" in link
    other.page.evaluate("location.hash = 't=0.042'")
    other.wait("stage.clock.frame === 1")
    damaged = open_page(link.partition("#")[0] + "#t=-1&view=1,2,NaN")
    damaged.ready()
    assert damaged.problems == []


def test_a_lost_context_is_restored(play: PlayerPage) -> None:
    """Catches a page that stays black after the graphics driver was reset."""
    script = (
        "const lose = stage.renderer.gl.getExtension('WEBGL_lose_context'); window.lose = lose; lose.loseContext();"
    )
    play.run(script)
    assert "graphics driver" in play.error()
    play.run("window.lose.restoreContext();")
    play.wait("player.panel.message.hidden")
    play.run("await player.settled();")
    assert play.run("stage.redraw(); return stage.renderer.readPixels().some((value, i) => i % 4 < 3 && value > 50);")


def test_screenshots_show_the_image(play: PlayerPage) -> None:
    """Catches a screenshot that is empty, because the browser clears the canvas after it is shown."""
    with play.page.expect_download() as download:
        play.run("player.panel.shoot.click();")
    from PIL import Image

    pixels = np.asarray(Image.open(download.value.path()).convert("RGB"))
    assert pixels.shape == (240, 320, 3)
    assert pixels.std() > 10
    assert download.value.suggested_filename == "frame_000000.png"


@pytest.mark.parametrize("count", [1, 2])
def test_cameras_can_be_selected(count: int, play: PlayerPage) -> None:
    """Catches a list of cameras that moves the view to a camera other than the selected one."""
    play.run(
        "player.panel.camera.value = argument; player.panel.camera.dispatchEvent(new Event('change'));", str(count)
    )
    script = "const c = stage.camera(1), m = stage.manifest.cameras[argument]; return [c.rotation, m.rotation];"
    got, expected = play.run(script, count)
    np.testing.assert_allclose(got, expected, atol=1e-9)


def test_cameras_are_in_the_order_of_their_names(play: PlayerPage) -> None:
    """Catches a held-out camera that the user does not find among its neighbours, and a key that takes another order
    than the list."""
    script = """
        player.panel.setCameras(["00", "2", "10", "01"]);
        const visited = [];
        player.moveToCamera = (index) => { player.cameraIndex = index; visited.push(index); };
        for (const code of ["KeyN", "KeyN", "KeyN", "KeyP", "KeyP", "KeyP"]) {
          player.dispatchEvent(new KeyboardEvent("keydown", { code, bubbles: true }));
        }
        return [[...player.panel.camera.options].map((option) => option.text), visited];
    """
    play.run("player.cameraIndex = -1; player.focus();")
    names, visited = play.run(script)
    assert names == ["Camera", "00", "01", "2", "10"]
    assert visited == [0, 3, 1, 3, 0, 2]
