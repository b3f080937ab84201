"""Playback over slow connections: requests, waiting, skipped frames, and compressed frames in memory."""

from __future__ import annotations

import threading
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import pytest

from fourd.viewer.publish.server import Part, SiteHandler, SiteServer
from fourd.viewer.publish.site import write_site
from tests.baking.scenes import write_scene
from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage

PLAN = """
    const {adaptStride, planStart, requiredWait} = await import('/player/play/buffering.js');
    const buffer = (rate, missing) => ({frames: missing.map((_, i) => i), missing, interval: 0.1, rate});
"""


class CountingHandler(SiteHandler):
    """Answers range requests of the scene with a delay, and counts the requests that wait at the same time. Requests
    for the bytes ``held`` wait until ``released`` is set."""

    server: CountingServer

    def _send_content(self, stream: BinaryIO, part: Part) -> None:
        if part.start == 0:
            super()._send_content(stream, part)
            return
        with self.server.lock:
            self.server.running += 1
            self.server.most = max(self.server.most, self.server.running)
            self.server.total += 1
        time.sleep(self.server.latency)
        if part.start in self.server.held:
            self.server.released.wait(timeout=60)
        with self.server.lock:
            self.server.running -= 1
        super()._send_content(stream, part)


class CountingServer(SiteServer):
    handler = CountingHandler
    latency = 0.1

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.lock = threading.Lock()
        self.running = self.most = self.total = 0
        self.held = range(0)
        self.released = threading.Event()


@pytest.fixture(scope="module")
def long_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of a scene of 40 frames. Tests must not change it."""
    folder = tmp_path_factory.mktemp("long")
    write_scene(folder / "scene.4dv", frames=40, points=300)
    write_site(folder / "scene.4dv", folder / "site", "stream")
    return folder / "site"


def test_the_wait_before_playback(play: PlayerPage) -> None:
    """Catches a start of playback that is too early for a later frame, and a start that is delayed although all frames
    are loaded.
    """
    script = "return [[1000, [0, 0, 100, 0]], [1000, [0, 0, 500, 0]], [1000, [50, 200, 200]], [10, [0, 0, 0]]]"
    waits = play.run(PLAN + script + ".map(([rate, missing]) => requiredWait(buffer(rate, missing), 1));")
    assert waits == pytest.approx([0, 0.3, 0.25, 0])


def test_the_stride_is_the_smallest_that_the_connection_carries(play: PlayerPage) -> None:
    """Catches pauses although playback could skip frames, and skipped frames although a short wait
    would be sufficient.
    """
    script = """
        const long = Array(1000).fill(100), short = Array(20).fill(100);
        const rates = [2000, 600, 400, 1];
        const strides = rates.map((rate) => planStart(buffer(rate, long), 3).stride);
        return [...strides, planStart(buffer(600, short), 3).stride];
    """
    assert play.run(PLAN + script) == [1, 2, 3, 6, 1]


def test_the_stride_follows_the_rate_during_playback(play: PlayerPage) -> None:
    """Catches a stride that stays large on a fast connection, and a stride that increases before this is necessary."""
    script = """
        const long = [0, ...Array(999).fill(100)], here = long.map((bytes, i) => (i < 50 ? 0 : bytes));
        return [
            adaptStride(buffer(2000, long), 3), adaptStride(buffer(600, long), 1), adaptStride(buffer(600, here), 1),
            adaptStride(buffer(1000, [1, ...Array(999).fill(0)]), 1),
        ];
    """
    assert play.run(PLAN + script) == [1, 2, 1, 1]


def test_the_rate_of_a_connection(play: PlayerPage) -> None:
    """Catches a measured rate that includes the time between requests, and a rate that never drops old measurements."""
    script = """
        const {LineRate} = await import('/player/scene/line_rate.js');
        let now = 0;
        const rate = new LineRate(() => now), seen = [rate.bytesPerSecond];
        const request = (bytes, ms) => { rate.begin(); now += ms; rate.receive(bytes); rate.end(); };
        request(1000, 500); now += 9000; request(1000, 500);
        seen.push(rate.bytesPerSecond);
        for (let i = 0; i < 20; i++) request(5000, 500);
        return [...seen, rate.bytesPerSecond];
    """
    empty, slow, fast = play.run(script)
    assert empty is None
    assert slow == pytest.approx(2000)
    assert 9000 < fast <= 10000


def test_a_stride_shows_every_second_frame(play: PlayerPage) -> None:
    """Catches frames whose numbers are not multiples of the stride, and a pause that changes the current frame."""
    script = """
        const {Clock} = await import('/player/play/clock.js');
        const clock = new Clock(7, 10);
        Object.assign(clock, {stride: 2, isPlaying: true});
        const frames = Array.from({length: 8}, () => { const {frame} = clock; clock.advance(0.1); return frame; });
        clock.seek(3);
        const next = clock.upcoming(9), all = clock.upcoming(2, 1);
        clock.toggle();
        return [frames, next, all, clock.frame, clock.upcoming(2)];
    """
    assert play.run(script) == [[0, 0, 2, 2, 4, 4, 6, 0], [4, 6, 0], [3, 4], 3, [4, 5]]


def test_several_frames_are_requested_at_the_same_time(open_page: Callable[..., PlayerPage], long_site: Path) -> None:
    """Catches a connection that is idle between responses, and a first image that is delayed by the download of other
    frames.
    """
    with serving(long_site, CountingServer) as server:
        assert isinstance(server, CountingServer)
        with zipfile.ZipFile(long_site / "scene.4dv") as scene:
            server.held = range(scene.getinfo("frames/000003/points").header_offset, scene.start_dir)
        page = open_page(server.url)
        page.ready()
        server.released.set()
        page.wait("stage.clock.frame > 2")
        assert server.most >= 2


def test_a_loop_is_downloaded_once_and_plays_without_pauses(
    open_page: Callable[..., PlayerPage], long_site: Path
) -> None:
    """Catches frames that are downloaded again in each loop, and playback that starts too early and pauses again."""
    with serving(long_site, CountingServer) as server:
        assert isinstance(server, CountingServer)
        page = open_page(server.url)
        page.ready()
        page.run("stage.clock.speed = 4;")
        page.wait("[...Array(40).keys()].every((frame) => stage.store.missingBytes(frame) === 0)")
        page.wait("!stage.playback.isBuffering")
        total = server.total
        page.run("stage.store.entries.clear(); window.loops = 0; window.last = 0;")
        count = (
            "(stage.clock.frame < window.last && window.loops++, window.last = stage.clock.frame, window.loops >= 2)"
        )
        page.wait(count)
        assert server.total == total
        assert page.run("return stage.clock.stride;") == 1


def test_compressed_frames_in_memory_are_bounded(play: PlayerPage) -> None:
    """Catches memory that grows without limit, frames that are dropped before they are due, and endless downloads."""
    script = """
        const {Downloads} = await import('/player/play/downloads.js');
        const reads = [], sizes = [];
        const read = async (names) => (reads.push(...names), new Map(names.map((name) => [name, new Uint8Array(100)])));
        const manifest = {points: Array(10).fill(1)}, source = {rate: {bytesPerSecond: 1000}};
        const downloads = new Downloads({read, manifest, source, sizeOf: () => 100}, () => {}, console.error);
        downloads.limit = 450;
        const kept = async (current) => {
            const wanted = Array.from({length: 10}, (_, step) => (current + step) % 10);
            downloads.want(wanted, (number) => [`${number}`].filter((name) => !downloads.get(number, name)), false);
            await new Promise((resolve) => setTimeout(resolve, 20));
            sizes.push(downloads.bytes);
            return [...downloads.members.keys()].sort((a, b) => a - b);
        };
        return [await kept(0), await kept(3), await kept(8), reads.length, Math.max(...sizes)];
    """
    assert play.run(script) == [[0, 1, 2, 3], [3, 4, 5, 6], [0, 1, 8, 9], 11, 400]
