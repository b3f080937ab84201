"""Make the figures of docs/guides/stylize.md that show styles in the viewer's window, on the web page and on a mesh.

    python tools/site/style_figures.py SCENE.4dv MESH.glb

SCENE is an exported scene, and MESH is a file that `fourd mesh` has written. The program needs Xvfb, xdotool,
python-xlib, Chromium and Playwright.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from fourd.viewer.publish.server import SiteServer  # noqa: E402
from fourd.viewer.publish.site import write_site  # noqa: E402
from tests.viewer.screen import Viewer, screen  # noqa: E402
from tests.viewer.web.page import PlayerPage  # noqa: E402
from tools.web.pages import open_browser, serving  # noqa: E402

FIGURES = ROOT / "docs" / "figures"
STYLES = ("toon", "gooch", "ink")
WINDOW = (1120, 960)
LINES_HEADING = (60, 514)
"""Position in pixels of the heading "Lines" in the panel's section "Style"."""
ZOOM_WHEEL_PX = -300
"""Distance by which the mouse wheel is scrolled on the web page, to move the camera towards the subject."""
WARM_UP_SECONDS = 8.0
"""Seconds to wait before the screenshot, until the style's lines, which fade in, have their full strength."""


@dataclass(frozen=True)
class Arguments:
    """The scene and the mesh."""

    scene: tyro.conf.Positional[Path]
    mesh: tyro.conf.Positional[Path]
    frame: int = 8
    """Index of the frame on the web page, from 0."""


def main(arguments: Arguments) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _save(FIGURES / "guide" / "style_panel.jpg", _window(arguments.scene, folder))
        _save(FIGURES / "web_styles.jpg", _page(arguments.scene, arguments.frame, folder))
        _save(FIGURES / "mesh_styles.jpg", _mesh(arguments.mesh, folder))


def _window(scene: Path, folder: Path) -> NDArray[np.uint8]:
    words = (str(scene.resolve()), "--size", *map(str, WINDOW), "--background", "1", "1", "1", "--style", "toon")
    with screen(*WINDOW) as display:
        viewer = Viewer(display, folder, *words)
        time.sleep(2.0)
        viewer.click(*LINES_HEADING)
        viewer.drag((700, 480), (860, 480), button=3)  # move the subject to the right of the panel
        time.sleep(WARM_UP_SECONDS)
        picture = viewer.picture()
        viewer.close()
    return picture


def _page(scene: Path, frame: int, folder: Path) -> NDArray[np.uint8]:
    write_site(scene, folder / "site", "stream")
    pictures = []
    with open_browser() as browser, serving(SiteServer(folder / "site")) as server:
        page = PlayerPage(browser.new_page(viewport={"width": 680, "height": 440}), server.url)
        page.pause(frame)
        page.wait("!player.panel.styles.hidden")
        page.page.mouse.move(340, 220)
        page.page.mouse.wheel(0, ZOOM_WHEEL_PX)
        for style in STYLES:
            page.run("await player.styleMenu.choose(argument); await player.settled();", style)
            for _ in range(12):  # draw further images, so that the lines fade in
                page.run("stage.isDirty = true; await player.settled(); stage.redraw();")
            pictures.append(_screenshot(page.page, folder / f"{style}.png"))
    return _side_by_side(pictures)


def _screenshot(page: Any, path: Path) -> NDArray[np.uint8]:
    page.screenshot(path=str(path))
    return np.asarray(Image.open(path).convert("RGB"))


def _mesh(mesh: Path, folder: Path) -> NDArray[np.uint8]:
    pictures = []
    for style in STYLES:
        out = folder / f"mesh_{style}"
        words = ["render", str(mesh), "--views", "side 3", "--style", style, "-o", str(out)]
        subprocess.run([sys.executable, "-m", "fourd.cli.main", *words], check=True)
        (path,) = sorted(out.rglob("*.png"))
        pictures.append(np.asarray(Image.open(path).convert("RGB")))
    top, bottom, left, right = _content(pictures[-1])
    return _side_by_side([picture[top:bottom, left:right] for picture in pictures])


def _content(picture: NDArray[np.uint8], margin_px: int = 24) -> tuple[int, int, int, int]:
    """Return the bounds (top, bottom, left, right) of the image content, extended by ``margin_px`` on each side. The
    content is all pixels whose colour differs from the colour of the top left pixel."""
    differs = (picture != picture[0, 0]).any(axis=2)
    rows, columns = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
    top, left = max(rows[0] - margin_px, 0), max(columns[0] - margin_px, 0)
    return top, rows[-1] + margin_px, left, columns[-1] + margin_px


def _side_by_side(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    return np.concatenate(pictures, axis=1)


def _save(path: Path, picture: NDArray[np.uint8]) -> None:
    Image.fromarray(picture).save(path, quality=88)
    print(path)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
