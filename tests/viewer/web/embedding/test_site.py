"""The documentation site: scenes play in its pages, and its pages and the player's are accessible."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fourd.scene import open_scene
from tests.viewer.web.conftest import serving
from tests.viewer.web.npm import installed
from tests.viewer.web.page import PlayerPage

ROOT = Path(__file__).parents[4]
FOLDER = "project"
"""Folder of the server in which the site is, as on GitHub Pages."""
DESKTOP, PHONE = (1280, 800), (390, 844)
MIN_CHANGED = 0.005
"""Share of the pixels that a moving figure changes at least."""
RULES = """async () => {
  const {violations} = await axe.run(document);
  const told = ({id, impact}, {target, failureSummary}) => `${id} (${impact}): ${target} ${failureSummary}`;
  return violations.flatMap((rule) => rule.nodes.map((node) => told(rule, node)));
}"""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of the built and served site, which ends with a slash."""
    pytest.importorskip("mkdocs", reason="mkdocs is not installed")
    pytest.importorskip("material", reason="mkdocs-material is not installed")
    folder = tmp_path_factory.mktemp("server")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder / FOLDER)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "SITE_URL": f"https://owner.test/{FOLDER}/"}
    subprocess.run(words, cwd=ROOT, env=environment, check=True)
    with serving(folder) as server:
        yield f"{server.url}{FOLDER}/"


def picture(page: PlayerPage) -> NDArray[np.int64]:
    """The pixels (H, W, 3) of the player, as the visitor sees them."""
    content = page.page.locator("fourd-player").screenshot()
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(np.int64)


def faults(page: Any) -> list[str]:
    """The faults that axe finds in a page, one line each."""
    page.add_script_tag(path=installed("axe-core") / "axe.min.js")
    return list(page.evaluate(RULES))


def test_the_scene_of_the_site_is_small() -> None:
    """Catches a scene that is slow to load on a phone, and one that makes each clone of the repository large."""
    path = ROOT / "docs" / "scenes" / "runner.4dv"
    assert path.stat().st_size < 3e6
    with open_scene(path) as scene:
        assert scene.manifest.frame_count > 12
        assert scene.manifest.encoding is not None


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_pixels_move_on_the_first_page(
    address: str, open_page: Callable[..., PlayerPage], size: tuple[int, int]
) -> None:
    """Catches a front page whose scene is missing, does not start, or is below the first screen, and a player whose
    modules are not found below the address at which the site is published."""
    page = open_page(address, size)
    page.ready()
    before = picture(page)
    frame = page.run("return stage.order.frame;")
    page.wait(f"stage.order.frame !== {frame}")
    after = picture(page)
    assert (np.abs(after - before).max(axis=2) > 24).mean() > MIN_CHANGED
    assert page.page.evaluate("document.querySelector('fourd-player').getBoundingClientRect().bottom") <= size[1]
    assert page.page.evaluate("document.documentElement.scrollWidth") <= size[0]
    assert page.problems == []


def test_the_gallery_plays_one_scene_at_a_time(address: str, open_page: Callable[..., PlayerPage]) -> None:
    """Catches pictures that start nothing, a style that is not drawn, and players that stay in memory when another one
    starts, which ends the page on phones."""
    page = open_page(f"{address}gallery.html", PHONE)
    buttons = page.page.locator(".scene > button")
    assert page.page.locator("fourd-player").count() == 0
    for number, style in ((1, "toon"), (4, "ink")):
        buttons.nth(number).click()
        page.ready()
        page.wait("stage.style !== null")
        assert page.page.locator("fourd-player").count() == 1
        assert page.run("return player.styleMenu.name;") == style
    assert buttons.nth(1).is_visible()
    assert not buttons.nth(4).is_visible()
    assert page.problems == []


def test_the_wheel_scrolls_the_page_until_a_click(address: str, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a scene that traps visitors who scroll down, and one to which nobody can come nearer."""
    page = open_page(address, DESKTOP)
    page.ready()
    distance = page.run("return stage.pose.distance;")
    page.page.locator("fourd-player").hover()
    page.page.mouse.wheel(0, 40)
    page.wait("window.scrollY > 0")
    assert page.run("return stage.pose.distance;") == pytest.approx(distance)
    page.page.locator("fourd-player").click(position={"x": 200, "y": 60})
    scrolled = page.page.evaluate("window.scrollY")
    page.page.mouse.wheel(0, 40)
    page.wait(f"stage.pose.distance > {1.01 * distance}")
    assert page.page.evaluate("window.scrollY") == scrolled


def test_a_scene_out_of_view_rests(address: str, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a player that uses the processor and the battery while the visitor reads the text below it."""
    page = open_page(address, PHONE)
    page.ready()
    page.page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    page.wait("!player.isInView")
    images = page.run("return stage.images;")
    page.page.wait_for_timeout(300)
    assert page.run("return stage.images;") == images
    page.page.evaluate("window.scrollTo(0, 0)")
    page.wait(f"stage.images > {images}")


def test_nothing_moves_for_visitors_who_ask_for_stillness(address: str, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a page that plays although the visitor's system asks pages for less motion."""
    page = open_page(address, DESKTOP, reduced_motion="reduce")
    page.ready()
    pose = page.run("await player.settled(); return stage.pose;")
    page.page.wait_for_timeout(300)
    assert page.run("return [stage.clock.isPlaying, stage.clock.frame, stage.pose];") == [False, 0, pose]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["index.html", "gallery.html"])
def test_pages_of_the_site_are_accessible(
    address: str, open_page: Callable[..., PlayerPage], name: str, scheme: str
) -> None:
    """Catches controls without names, and text without contrast, that axe finds."""
    page = open_page(address + name, DESKTOP, color_scheme=scheme)
    page.page.wait_for_selector("fourd-player, .scene > button")
    if name == "gallery.html":
        page.page.locator(".scene > button").first.click()
    page.pause(0)  # axe takes twice as long beside a scene that plays
    # Colours that change gradually when the size changes would be measured on the way.
    page.page.add_style_tag(content="* { transition: none !important; }")
    for width, height in (DESKTOP, PHONE):
        page.page.set_viewport_size({"width": width, "height": height})
        assert faults(page.page) == [], width


def test_the_page_of_a_scene_is_accessible(object_site: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches what :func:`test_pages_of_the_site_are_accessible` catches, in the page of ``fourd web``, while its list
    of keys is open."""
    with serving(object_site) as server:
        page = open_page(server.url, DESKTOP, bypass_csp=True)
        page.pause(0)
        page.run("player.panel.question.click();")
        assert faults(page.page) == []
        page.page.set_viewport_size({"width": PHONE[0], "height": PHONE[1]})
        assert faults(page.page) == []
