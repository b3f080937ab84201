"""Take pictures of the web player, side by side in one image.

The pictures of the player in docs/ are made with:

    fourd web docs/scenes/runner.4dv -o site
    python tools/figures/web_player.py site docs/figures/web_player.jpg --size 1100 680 --frame 4
    python tools/figures/web_player.py site docs/figures/web_styles.jpg --size 560 520 --frame 4 --turn 30 \
        --styles toon gooch ink
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from PIL import Image

from fourd.base.files import atomic_path
from fourd.viewer.publish.server import SiteServer
from tests.viewer.web.page import PlayerPage
from tools.measurements.web.pages import open_browser, serving


@dataclass(frozen=True)
class Arguments:
    """Options of the pictures."""

    site: tyro.conf.Positional[Path]
    """A folder that `fourd web` has written."""
    out: tyro.conf.Positional[Path]
    """The image file to write."""
    size: tuple[int, int] = (1100, 680)
    """Width and height of each picture in pixels."""
    frame: int = 0
    """The frame that the player shows."""
    camera: int = 0
    """Index of the camera of the capture from which the player shows it."""
    turn: float = 0.0
    """Angle in degrees by which the view is turned around the scene."""
    closer: float = 1.0
    """Factor by which the view is nearer to the scene than the camera."""
    styles: tuple[str, ...] = ("none",)
    """The style of each picture."""


def picture(page: PlayerPage, style: str) -> Image.Image:
    """The page, while the player shows the scene in a style."""
    page.run("await player.styleMenu.choose(argument); await player.settled();", style)
    return Image.open(io.BytesIO(page.page.screenshot())).convert("RGB")


def show(page: PlayerPage, arguments: Arguments) -> None:
    """Move the player to the frame and the view."""
    page.pause(arguments.frame)
    page.wait("!player.panel.styles.hidden")
    values: dict[str, Any] = {"camera": arguments.camera, "turn": arguments.turn, "closer": arguments.closer}
    page.run(
        """
        const { dolly, orbit } = await import("./player/navigate/pose.js");
        player.moveToCamera(argument.camera);
        stage.setPose(dolly(orbit(stage.pose, argument.turn * Math.PI / 180, 0), 1 / argument.closer));
        await player.settled();
        """,
        values,
    )


def main() -> None:
    """Take the pictures and write the image."""
    arguments = tyro.cli(Arguments, description=__doc__)
    width, height = arguments.size
    with open_browser() as browser, serving(SiteServer(arguments.site)) as server:
        page = PlayerPage(browser.new_page(viewport={"width": width, "height": height}), server.url)
        show(page, arguments)
        pictures = [picture(page, style) for style in arguments.styles]
    joined = Image.new("RGB", (width * len(pictures), height))
    for number, each in enumerate(pictures):
        joined.paste(each, (width * number, 0))
    with atomic_path(arguments.out) as temporary:
        joined.save(temporary, "JPEG", quality=88, optimize=True)


if __name__ == "__main__":
    main()
