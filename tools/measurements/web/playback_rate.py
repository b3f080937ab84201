"""Measure how smoothly a scene plays in Chromium over a slow connection.

    python tools/measurements/web/playback_rate.py scene.4dv --mbps 50
    python tools/measurements/web/playback_rate.py scene.4dv --mbps 50 --tier stream --repeat 25

The program opens the page of the scene with an empty browser cache, from a server that limits the data rate to --mbps.
It prints the time from opening the page to the start of playback and, for playback, the pauses, the images per second
and the amount of received data. It also moves the time bar to frames that are not in memory, and prints the time until
each frame is shown. The scene is packed in a tier (such as "stream") and a level of this tier (a set of quantisation
steps), which determine its size and quality. If --tier is not given, the program chooses the tier and the level with
the best quality that can be played at the data rate --mbps, as `fourd web --max-mbps` does. Use --repeat to make the
scene longer, by repeating its frames with new frame numbers. The program needs Chromium and the package playwright.
"""

from __future__ import annotations

import json
import statistics
import struct
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import tyro

from fourd.scene.files.encoding import Tier
from fourd.scene.packing.rate import choose_tier
from fourd.viewer.publish.server import Part, SiteHandler, SiteServer
from fourd.viewer.publish.site import SCENE_NAME, write_site
from tools.measurements.tables import table
from tools.measurements.web.pages import open_browser, serving

CHUNK = 1 << 14
LOCAL_HEADER, SIZES_AT, NAME_LENGTH_AT = 30, 18, 26
"""Size of a local file header in a ZIP archive, and the offsets of two of its fields (ZIP appnote 4.3.7)."""
CREDIT_SECONDS = 0.05
"""Maximum delay, in seconds, that the server makes up for. After such a delay, which occurs if the operating system
wakes the server too late, the server briefly sends faster than the data rate."""
PLAY = """
async (milliseconds) => {
  const sleep = () => new Promise((resolve) => setTimeout(resolve, 5));
  let player;
  while (!(player = document.querySelector('fourd-player'))?.stage) await sleep();
  const {stage} = player, {clock, playback} = stage, {source} = stage.store.file;
  while (playback.isBuffering) await sleep();
  const start = performance.now();
  let now = start, frame = stage.order.frame, shownAt = start, bytes = source.bytesReceived;
  let waiting = 0, pauses = 0, wasWaiting = false, shown = 0, half = 0;
  const gaps = [], strides = [];
  while (now - start < milliseconds) {
    await sleep();
    const last = now;
    now = performance.now();
    if (stage.isWaiting) waiting += now - last;
    if (stage.isWaiting && !wasWaiting) pauses++;
    wasWaiting = stage.isWaiting;
    if (strides.at(-1) !== clock.stride) strides.push(clock.stride);
    if (half === 0 && now - start > milliseconds / 2) half = source.bytesReceived;
    if (stage.order.frame === frame) continue;
    frame = stage.order.frame;
    gaps.push(now - shownAt);
    shownAt = now;
    shown++;
  }
  gaps.sort((a, b) => a - b);
  const seconds = (now - start) / 1000, mbps = (count, time) => (count * 8) / time / 1e6;
  return {
    "first image, s": player.firstImageMs / 1000,
    "start of playback, s": start / 1000,
    "images per second": shown / seconds,
    "pauses": pauses,
    "time in pauses, %": (100 * waiting) / 1000 / seconds,
    "95% of the images follow within, ms": gaps[Math.floor(0.95 * gaps.length)] ?? 0,
    "received, Mbit/s": mbps(source.bytesReceived - bytes, seconds),
    "received in the second half, Mbit/s": mbps(source.bytesReceived - half, seconds / 2),
    "largest stride": Math.max(...strides),
    "last stride": strides.at(-1),
  };
}
"""
SEEK = """
async (parts) => {
  const sleep = () => new Promise((resolve) => setTimeout(resolve, 5));
  let player;
  while (!(player = document.querySelector('fourd-player'))?.firstImageMs) await sleep();
  const {stage} = player, times = [];
  for (const part of parts) {
    const frame = Math.floor(part * stage.clock.frames);
    const start = performance.now();
    player.seek(frame);
    while (stage.order.frame !== frame) await sleep();
    times.push(performance.now() - start);
  }
  return times;
}
"""
SEEKS = (0.5, 0.9, 0.2, 0.7, 0.35)
"""Positions on the time bar to which the program seeks, as fractions of the scene."""


@dataclass(frozen=True)
class Arguments:
    """The scene and the connection."""

    scene: tyro.conf.Positional[Path]
    """An unpacked .4dv file."""
    mbps: float = 50.0
    """Data rate of the connection in megabits per second."""
    served_mbps: float | None = None
    """Data rate at which the server sends, in megabits per second. The default is --mbps. Set a higher rate to find out
    whether this machine decodes and draws fast enough. The level of the scene is still chosen for --mbps."""
    latency: float = 0.02
    """Delay of each response in seconds."""
    seconds: float = 10.0
    """Duration of the measured playback in seconds."""
    tier: Tier | None = None
    """Tier (quality, such as "stream") in which the scene is packed, at the tier's default level (set of quantisation
    steps). By default, the best tier and level that fit the connection are used."""
    repeat: int = 1
    """Number of times that the frames are played in succession."""
    rounds: int = 5
    """Number of measurements. Each measurement starts with an empty browser cache."""
    size: tuple[int, int] = (256, 256)
    """Width and height of the page in pixels."""


class SlowHandler(SiteHandler):
    """Sends each response with a delay, and shares the data rate of the server among all connections."""

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
    """Serves a folder at ``mbps`` megabits per second. Each response starts after a delay of ``latency`` seconds."""

    handler = SlowHandler

    def __init__(self, folder: Path, mbps: float, latency: float) -> None:
        super().__init__(folder)
        self.latency = latency
        self._bytes_per_second = mbps * 1e6 / 8
        self._lock = threading.Lock()
        self._free_at = 0.0

    def wait_for(self, count: int) -> None:
        """Sleep until a connection with the server's data rate would have transferred ``count`` bytes, after the bytes
        of earlier calls."""
        with self._lock:
            start = max(self._free_at, time.monotonic() - CREDIT_SECONDS)
            self._free_at = start + count / self._bytes_per_second
            until = self._free_at
        time.sleep(max(until - time.monotonic(), 0))


def main(arguments: Arguments) -> None:
    """Serve the scene, play it several times, and print the medians and the ranges."""
    tier, level = arguments.tier, None
    if tier is None:
        choice = choose_tier(arguments.scene, arguments.mbps, arguments.scene, for_web=True)
        tier, level = choice.tier, choice.level
        print(choice)
    with tempfile.TemporaryDirectory() as folder:
        site = Path(folder) / "site"
        write_site(arguments.scene, site, tier, level=level)
        if arguments.repeat > 1:
            repeat_frames(site / SCENE_NAME, arguments.repeat)
        with serving(SlowServer(site, arguments.served_mbps or arguments.mbps, arguments.latency)) as server:
            rounds = [play(server.url, arguments) for _ in range(arguments.rounds)]
            seeks = [time for _ in range(arguments.rounds) for time in seek(server.url, arguments)]
    measured = {name: [each[name] for each in rounds] for name in rounds[0]} | {"frame after a seek, ms": seeks}
    rows = [
        [name, f"{statistics.median(values):.3g}", f"{min(values):.3g} to {max(values):.3g}"]
        for name, values in measured.items()
    ]
    print(table(["measurement", "median", "range"], rows))


def play(url: str, arguments: Arguments) -> dict[str, float]:
    """Open the page in a new browser and measure one playback."""
    with opened(url, arguments) as page:
        result: dict[str, float] = page.evaluate(PLAY, 1000 * arguments.seconds)
    return result


def seek(url: str, arguments: Arguments) -> list[float]:
    """Open the page in a new browser, and seek to several frames as soon as the first image is shown. Return the time
    in milliseconds until each frame is shown."""
    with opened(url, arguments) as page:
        times: list[float] = page.evaluate(SEEK, SEEKS)
    return times


@contextmanager
def opened(url: str, arguments: Arguments) -> Iterator[Any]:
    """Yield the page in a new browser."""
    with open_browser() as browser:
        page = browser.new_page(viewport={"width": arguments.size[0], "height": arguments.size[1]})
        page.goto(url, wait_until="commit")
        yield page


def repeat_frames(scene: Path, times: int) -> None:
    """Repeat the frames of a packed scene. The repeated frames get new frame numbers, but use the same bytes of the
    file.

    The manifest grows, so the ZIP directory at the end of the file becomes wrong. The web player can still read the
    file, because it finds the members by their offsets in the manifest.
    """
    content = scene.read_bytes()
    name, extra = struct.unpack_from("<2H", content, NAME_LENGTH_AT)
    (size,) = struct.unpack_from("<L", content, SIZES_AT)
    start = LOCAL_HEADER + name + extra
    manifest = json.loads(content[start : start + size])
    frames, members = manifest["frames"], manifest["members"]
    room = (times + 1) * size
    moved = {member: [offset + room - size, length] for member, (offset, length) in members.items()}
    manifest["frames"] = [{**frame, "number": index} for index, frame in enumerate(times * frames)]
    manifest["members"] = {
        member.replace(f"{index:06d}", f"{index + copy * len(frames):06d}"): place
        for copy in range(times)
        for index in range(len(frames))
        for member, place in moved.items()
        if member.startswith(f"frames/{index:06d}/")
    } | {member: place for member, place in moved.items() if not member.startswith("frames/")}
    text = json.dumps(manifest, separators=(",", ":")).encode().ljust(room)
    header = content[:SIZES_AT] + 2 * struct.pack("<L", room) + content[NAME_LENGTH_AT:start]
    scene.write_bytes(header + text + content[start + size :])


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
