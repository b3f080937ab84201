"""Measure how long the web player takes to draw an image with and without a style.

    python tools/measurements/web/style_times.py SITE --rounds 15

SITE is a folder that `fourd web` has written. The page shows frame 0 at 512 x 512 pixels in Chromium. The styles take
turns, and each image is finished before the next one starts.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path

from fourd.viewer.publish.server import SiteServer
from tests.viewer.web.page import PlayerPage
from tools.measurements.web.pages import open_browser, serving

DRAW = """
const { gl } = stage.renderer, pixel = new Uint8Array(4), started = performance.now();
stage.redraw();
gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
return performance.now() - started;
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path)
    parser.add_argument("--rounds", type=int, default=15)
    arguments = parser.parse_args()
    with open_browser() as browser, serving(SiteServer(arguments.site)) as server:
        page = PlayerPage(browser.new_page(viewport={"width": 512, "height": 512}), server.url)
        page.pause(0)
        page.wait("!player.panel.styles.hidden")
        names = page.run("return [...player.panel.styles.options].map((option) => option.value);")
        times: dict[str, list[float]] = {name: [] for name in names}
        for _ in range(arguments.rounds):
            for name in names:
                page.run("await player.styleMenu.choose(argument); await player.settled();", name)
                times[name].append(page.run(DRAW))
    plain = statistics.median(times["none"])
    for name, found in times.items():
        print(f"{name}: {statistics.median(found):.0f} ms, {statistics.median(found) / plain:.2f} of none")


if __name__ == "__main__":
    main()
