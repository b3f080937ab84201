"""The bar of the web player: one row of controls, which are large for fingers on touch screens."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage

DESKTOP, WINDOW, PHONE, TINY = (1280, 800), (700, 500), (390, 844), (128, 128)
SIZES = [(DESKTOP, False), (WINDOW, False), (PHONE, True), (DESKTOP, True), (TINY, False)]
"""Sizes of the page, and whether it has a touch screen."""
MIN_TARGET_PX = 44
"""Smallest width and height of a target for fingers (WCAG 2.5.5)."""
CONTROLS = """
    const all = [...player.panel.bar.querySelectorAll("button, select, input")];
    return all.filter((each) => each.checkVisibility()).map((each) => {
      const {left, right, top, width, height} = each.getBoundingClientRect();
      return {name: each.title, left, right, middle: top + height / 2, width, height};
    });
"""


def controls(page: PlayerPage) -> list[dict[str, Any]]:
    """Name and place of each control of the bar that is shown."""
    return list(page.run(CONTROLS))


@pytest.mark.parametrize(("size", "touch"), SIZES)
def test_controls_are_in_one_row(
    object_site: Path, open_page: Callable[..., PlayerPage], size: tuple[int, int], touch: bool
) -> None:
    """Catches a bar that wraps and covers the scene, controls that are cut off, and buttons too small for a finger."""
    with serving(object_site) as server:
        page = open_page(server.url, size, has_touch=touch, is_mobile=touch)
        page.pause(0)
        page.wait("!player.panel.styles.hidden")
        shown = controls(page)
    needed = {"Play or pause (Space)", "Full screen (F)", *(() if size == TINY else ("Time",))}
    assert needed <= {each["name"] for each in shown}
    assert max(each["middle"] for each in shown) - min(each["middle"] for each in shown) < 2
    assert min(each["left"] for each in shown) >= 0
    assert max(each["right"] for each in shown) <= size[0]
    assert not touch or min(min(each["width"], each["height"]) for each in shown) >= MIN_TARGET_PX
    assert ("More controls" in {each["name"] for each in shown}) == (size != DESKTOP)


def test_a_button_shows_the_controls_without_room(object_site: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches controls that nobody with a phone can reach, and a button that does not say whether they are shown."""
    with serving(object_site) as server:
        wide = open_page(server.url, DESKTOP)
        page = open_page(server.url, PHONE, has_touch=True, is_mobile=True)
        for each in (wide, page):
            each.pause(0)
            each.wait("!player.panel.styles.hidden")
        before = controls(page)
        page.page.get_by_role("button", name="More controls", expanded=False).tap()
        opened = controls(page)
        assert {each["name"] for each in opened} == {each["name"] for each in controls(wide)} | {"More controls"}
        assert min(each["left"] for each in opened) >= 0
        assert max(each["right"] for each in opened) <= PHONE[0]
        page.page.get_by_role("button", name="Help (?)", exact=True).tap()
        page.wait("!player.panel.help.hidden")
        assert page.page.get_by_text("one finger", exact=True).is_visible()
        assert not page.page.get_by_text("drag, one finger").is_visible()
        page.page.get_by_role("button", name="More controls", expanded=True).tap()
        assert controls(page) == before


@pytest.mark.parametrize(("size", "opens"), [(DESKTOP, False), (WINDOW, False), (WINDOW, True), (PHONE, True)])
def test_the_tab_key_follows_the_rows(
    object_site: Path, open_page: Callable[..., PlayerPage], size: tuple[int, int], opens: bool
) -> None:
    """Catches a Tab key that jumps between the rows of controls instead of following them."""
    with serving(object_site) as server:
        page = open_page(server.url, DESKTOP)
        page.pause(0)
        page.wait("!player.panel.styles.hidden")
        page.page.set_viewport_size({"width": size[0], "height": size[1]})
        page.wait(f"(player.panel.bar.firstChild === player.panel.extra) === {str(size != DESKTOP).lower()}")
        if opens:
            page.run("player.panel.more.focus();")
            page.page.keyboard.press("Enter")
            assert page.run("return player.shadowRoot.activeElement === player.panel.loop;")
        rows = sorted(controls(page), key=lambda each: (round(each["middle"]), each["left"]))
        page.run("player.focus();")
        reached = []
        for _ in rows:
            page.page.keyboard.press("Tab")
            reached.append(page.run("return player.shadowRoot.activeElement?.title;"))
    assert reached == [each["name"] for each in rows]
