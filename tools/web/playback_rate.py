"""Measure whether a scene plays without pauses in Chromium over a slow connection.

    python tools/web/playback_rate.py scene.4dv --mbps 50

The program chooses a level as `fourd web --max-mbps` does, and serves the page at this rate. Frames are dropped from
the player's memory after they are shown, so that every frame is fetched each time, as in a long scene. The program
prints the share of the time in which playback waits for frames. It needs Chromium and the package playwright.
"""

from __future__ import annotations

import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import tyro
from pages import open_browser, serving

from fourd.baking.files.encoding import Tier
from fourd.baking.packing.rate import choose_tier
from fourd.viewer.publish.server import Part, SiteHandler, SiteServer
from fourd.viewer.publish.site import write_site

CHUNK = 1 << 14
CREDIT_SECONDS = 0.05
"""Time that the server may catch up if the operating system wakes it late."""
READY = "() => document.querySelector('fourd-player').firstImageMs > 0"
PLAY = """
async (milliseconds) => {
  const {stage} = document.querySelector('fourd-player'), {clock, store} = stage;
  const start = performance.now(), received = store.file.source.bytesReceived;
  let waiting = 0, shown = 0, last = start, frame = clock.frame, pauses = 0, wasWaiting = false;
  clock.isPlaying = true;
  while (last - start < milliseconds) {
    await new Promise((resolve) => setTimeout(resolve, 10));
    const now = performance.now();
    if (stage.isWaiting) waiting += now - last;
    if (stage.isWaiting && !wasWaiting) pauses++;
    wasWaiting = stage.isWaiting;
    last = now;
    for (; frame !== clock.frame; frame = (frame + 1) % clock.frames) {
      store.entries.delete(frame);
      shown++;
    }
  }
  return {shown, pauses, waiting, ms: last - start, bytes: store.file.source.bytesReceived - received};
}
"""


@dataclass(frozen=True)
class Arguments:
    """The scene and the connection."""

    scene: tyro.conf.Positional[Path]
    """An unpacked .4dv file."""
    mbps: float = 50.0
    """Rate of the connection in megabits per second."""
    served_mbps: float | None = None
    """Rate at which the page is served, in megabits per second. The default is the rate of the connection. With a high
    rate, the program shows whether this machine decodes and draws fast enough."""
    latency: float = 0.02
    """Seconds until the server answers."""
    seconds: float = 10.0
    """Seconds of playback."""
    tier: Tier | None = None
    """Use the default level of this tier. The default is the level that fits the connection."""
    size: tuple[int, int] = (256, 256)
    """Width and height of the page in pixels."""


class SlowHandler(SiteHandler):
    """Answers late, and shares the rate of the server among all connections."""

    server: SlowServer

    def _send_content(self, stream: BinaryIO, part: Part) -> None:
        time.sleep(self.server.latency)
        stream.seek(part.start)
        for first in range(0, part.length, CHUNK):
            content = stream.read(min(CHUNK, part.length - first))
            self.server.wait_for(len(content))
            try:
                self.wfile.write(content)
            except OSError:
                self.close_connection = True
                return


class SlowServer(SiteServer):
    """Serves a folder at ``mbps`` megabits per second. Each answer starts ``latency`` seconds late."""

    handler = SlowHandler

    def __init__(self, folder: Path, mbps: float, latency: float) -> None:
        super().__init__(folder)
        self.latency = latency
        self._bytes_per_second = mbps * 1e6 / 8
        self._lock = threading.Lock()
        self._free_at = 0.0

    def wait_for(self, count: int) -> None:
        """Wait until the connection has transferred ``count`` more bytes."""
        with self._lock:
            start = max(self._free_at, time.monotonic() - CREDIT_SECONDS)
            self._free_at = start + count / self._bytes_per_second
            until = self._free_at
        time.sleep(max(until - time.monotonic(), 0))


def main(arguments: Arguments) -> None:
    """Serve the scene, play it and print the result."""
    tier, level = arguments.tier, None
    if tier is None:
        choice = choose_tier(arguments.scene, arguments.mbps, arguments.scene, for_web=True)
        tier, level = choice.tier, choice.level
        print(choice)
    with tempfile.TemporaryDirectory() as folder:
        site = Path(folder) / "site"
        write_site(arguments.scene, site, tier, level=level)
        with serving(SlowServer(site, arguments.served_mbps or arguments.mbps, arguments.latency)) as server:
            result = _play(server.url, arguments)
    seconds = result["ms"] / 1000
    print(
        f"{result['shown']} frames in {seconds:.1f} s ({result['shown'] / seconds:.1f} per second), "
        f"{result['bytes'] / max(result['shown'], 1) / 1e3:.0f} kB per frame, "
        f"{result['bytes'] * 8 / seconds / 1e6:.1f} Mbit/s, {result['pauses']} pauses, "
        f"{100 * result['waiting'] / result['ms']:.1f} % of the time waiting"
    )


def _play(url: str, arguments: Arguments) -> dict[str, float]:
    with open_browser() as browser:
        page = browser.new_page(viewport={"width": arguments.size[0], "height": arguments.size[1]})
        page.goto(url)
        page.wait_for_function(READY, timeout=60_000)
        result: dict[str, float] = page.evaluate(PLAY, 1000 * arguments.seconds)
    return result


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
