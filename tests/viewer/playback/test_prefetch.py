"""Prefetching of frames: order, memory limits, errors and threads."""

from __future__ import annotations

import re
import threading
import time
import weakref
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.scene import BakedFrame, SceneBackground, SceneManifest, SceneReader
from fourd.scene.packed.names import member_name
from fourd.viewer.playback.prefetch import FramePrefetcher
from tests.baking.scenes import manifest, random_frame, write_scene

VIEWS = 2
MEMBER = member_name(1, "xyz")


class CountedSource:
    """A frame source that creates a new frame for every read and tracks which frames are still in memory.

    Attributes:
        limit: maximum total size in bytes of the live frames during a read. The limit does not apply to one or two live
            frames.
        reads: indices of the frames that were read.
        max_alive: maximum number of live frames during a read.
        gate: event that reads wait for.
        has_started: set when a read reaches the gate.
        failures: exceptions to raise, by frame.
        seed: random seed of the frames' content.
        close_count: number of calls of ``close``.
    """

    def __init__(self, points: list[int], limit: int = 1 << 40) -> None:
        self.points, self.limit = points, limit
        self.manifest: SceneManifest = manifest(VIEWS, len(points))
        self.reads: list[int] = []
        self.max_alive = 0
        self.gate, self.has_started = threading.Event(), threading.Event()
        self.gate.set()
        self.failures: dict[int, Exception] = {}
        self.seed = 0
        self.close_count = 0
        self._sizes: dict[int, int] = {}

    @property
    def alive(self) -> list[int]:
        """Sizes in bytes of the frames that are still in memory."""
        return list(self._sizes.values())

    def read(self, index: int) -> BakedFrame:
        alive = self.alive
        assert len(alive) <= 2 or sum(alive) <= self.limit, "the live frames exceed the limit"
        self.max_alive = max(self.max_alive, len(alive))
        self.reads.append(index)
        if index in self.failures:
            raise self.failures[index]
        frame = self.frame(index)
        number = len(self.reads)
        self._sizes[number] = frame.nbytes
        weakref.finalize(frame, self._sizes.pop, number)
        self.has_started.set()
        assert self.gate.wait(10)
        return frame

    def frame(self, index: int) -> BakedFrame:
        """Create the frame with the given index."""
        return random_frame(self.points[index], VIEWS, seed=100 * self.seed + index)

    def close(self) -> None:
        self.close_count += 1


def frame_bytes(points: int) -> int:
    return random_frame(points, VIEWS, seed=0).nbytes


def eventually(condition: Callable[[], bool]) -> None:
    """Wait for other threads until the condition holds."""
    for _ in range(2000):
        if condition():
            return
        time.sleep(0.002)
    raise AssertionError("the condition never held")


def reads_at_rest(source: CountedSource, count: int) -> list[int]:
    """Wait for at least ``count`` reads, and then briefly for further reads. Returns the indices that were read."""
    eventually(lambda: len(source.reads) >= count)
    time.sleep(0.02)
    return source.reads


def assert_same(got: BakedFrame | None, expected: BakedFrame) -> None:
    assert got is not None
    for attribute in expected.attributes:
        np.testing.assert_array_equal(getattr(got, attribute.name), getattr(expected, attribute.name))


def locate_member(path: Path, name: str) -> tuple[int, int]:
    """Offset and size in bytes of a member of the ZIP file."""
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo(name)
    header = path.read_bytes()[info.header_offset : info.header_offset + 30]
    lengths = int.from_bytes(header[26:28], "little") + int.from_bytes(header[28:30], "little")
    return info.header_offset + 30 + lengths, info.file_size


def overwrite(path: Path, offset: int, content: bytes) -> None:
    """Overwrite bytes of a file in place."""
    with path.open("rb+") as file:
        file.seek(offset)
        file.write(content)


def write_damaged_scene(path: Path, kind: str) -> list[BakedFrame]:
    """Write a scene with NaN in frame 1 and return the original frames. The checksum of the frame is wrong if ``kind``
    is "checksum", and valid otherwise."""
    written = write_scene(path)
    offset, size = locate_member(path, MEMBER)
    invalid = np.full(size // 4, np.nan, "<f4").tobytes()
    if kind == "checksum":
        overwrite(path, offset, invalid)
        return written
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, invalid if name == MEMBER else content)
    return written


def test_frames_equal_those_of_the_file(tmp_path: Path) -> None:
    """Catches a frame with a wrong index, in forward and backward playback, after jumps and when playback loops."""
    written = write_scene(tmp_path / "scene.4dv", frames=5)
    prefetcher = FramePrefetcher(SceneReader(tmp_path / "scene.4dv"), buffer_bytes=2 * written[-1].nbytes)
    for index, direction in [
        *((i % 5, 1) for i in range(11)),
        *((i % 5, -1) for i in range(10, 2, -1)),
        (1, 1),
        (4, 1),
    ]:
        assert_same(prefetcher.get(index, direction, wait=True), written[index])
    prefetcher.close()


@pytest.mark.parametrize(
    ("head", "direction", "order"),
    [(0, 1, [0, 1, 2, 3, 4]), (3, 1, [3, 4, 0, 1, 2]), (4, -1, [4, 3, 2, 1, 0]), (1, -1, [1, 0, 4, 3, 2])],
)
def test_prefetch_follows_the_direction(head: int, direction: int, order: list[int]) -> None:
    """Catches prefetching in the wrong direction, prefetching that stops at the last frame, and frames that are read
    twice."""
    source = CountedSource([10] * 5)
    prefetcher = FramePrefetcher(source)
    prefetcher.get(head, direction)
    assert reads_at_rest(source, 5) == order
    prefetcher.close()


def test_frames_that_were_expensive_are_kept() -> None:
    """Catches a run that bakes all its frames ahead, which slows its training, or each frame again in every round."""
    source = CountedSource([10] * 4)
    prefetcher = FramePrefetcher(source, wanted_frames=2)
    for round_ in range(2):
        for index in range(4):
            prefetcher.get(index, wait=True)
            assert reads_at_rest(source, 4 if round_ else min(index + 2, 4)) == [0, 1, 2, 3][: index + 2 + 4 * round_]
    prefetcher.close()


def test_nothing_is_read_before_the_first_request() -> None:
    """Catches a read before the first request, which would waste time if another frame is shown first."""
    source = CountedSource([10] * 5)
    prefetcher = FramePrefetcher(source)
    assert reads_at_rest(source, 0) == []
    prefetcher.close()


def test_a_reversal_reads_the_frames_of_the_new_direction() -> None:
    """Catches prefetching that continues in the old direction after a reversal, or that reads buffered frames again."""
    source = CountedSource([10] * 10)
    prefetcher = FramePrefetcher(source, buffer_bytes=3 * frame_bytes(10))
    prefetcher.get(5, 1)
    assert reads_at_rest(source, 3) == [5, 6, 7]
    prefetcher.get(5, -1)
    assert reads_at_rest(source, 5) == [5, 6, 7, 4, 3]
    assert prefetcher.get(4, -1) is not None
    assert reads_at_rest(source, 6)[5:] == [2]
    prefetcher.close()


@pytest.mark.parametrize("buffer_bytes", [0, 1, frame_bytes(10), 2 * frame_bytes(10), 5 * frame_bytes(10) - 1])
def test_the_buffer_holds_only_frames_that_fit(buffer_bytes: int) -> None:
    """Catches memory that grows during playback, and a buffer with fewer than two frames, which would stop playback."""
    source = CountedSource([10] * 12)
    prefetcher = FramePrefetcher(source, buffer_bytes=buffer_bytes)
    fitting = max(2, buffer_bytes // frame_bytes(10))
    for index in [0, 1, 2, 3, 9, 10, 11, 0, 1]:
        prefetcher.get(index, wait=True)
        eventually(lambda: prefetcher.frames_ahead == fitting - 1)
        eventually(lambda: len(source.alive) == fitting)
    assert source.max_alive == fitting
    prefetcher.close()


def test_frames_of_different_sizes_fit_together() -> None:
    """Catches a buffer capacity that is computed from small frames but filled with large frames."""
    rng = np.random.default_rng(3)
    limit = 3 * frame_bytes(400)
    source = CountedSource([int(points) for points in rng.integers(1, 400, 30)], limit)
    prefetcher = FramePrefetcher(source, buffer_bytes=limit)
    for index in range(60):
        assert_same(prefetcher.get(index % 30, wait=True), source.frame(index % 30))
    prefetcher.close()


def test_the_background_counts_towards_the_buffer() -> None:
    """Catches a buffer capacity that ignores the memory of the background."""
    source = CountedSource([10] * 12)
    source.manifest = replace(source.manifest, kind="full", background=SceneBackground(30, shadow=False))
    prefetcher = FramePrefetcher(source, buffer_bytes=5 * frame_bytes(10) + frame_bytes(30) - 1)
    prefetcher.get(0, wait=True)
    reads_at_rest(source, 4)
    assert (prefetcher.frames_ahead, len(source.alive)) == (3, 4)
    prefetcher.close()


def test_a_large_frame_ahead_is_not_read_repeatedly() -> None:
    """Catches a large frame that is evicted because of its size and then read again, in an endless loop."""
    source = CountedSource([10] * 5 + [100] + [10] * 14)
    prefetcher = FramePrefetcher(source, buffer_bytes=3 * frame_bytes(100))
    prefetcher.get(0, wait=True)
    time.sleep(0.04)
    prefetcher.close()
    assert len(source.reads) <= 2 * len(source.points)


def test_a_frame_is_returned_once_it_is_read() -> None:
    """Catches a slow read that blocks the viewer, and a frame that every call reads again."""
    source = CountedSource([10] * 3)
    source.gate.clear()
    prefetcher = FramePrefetcher(source)
    assert prefetcher.get(1) is None
    assert source.has_started.wait(10)
    assert prefetcher.get(1) is None
    source.gate.set()
    frame = prefetcher.get(1, wait=True)
    assert_same(frame, source.frame(1))
    assert prefetcher.get(1) is frame
    assert sorted(reads_at_rest(source, 3)) == [0, 1, 2]
    prefetcher.close()


def test_frames_ahead_counts_buffered_frames() -> None:
    """Catches a count of buffered frames that includes the current frame, frames in the wrong direction, or frames
    after a gap."""
    source = CountedSource([10] * 6)
    source.gate.clear()
    prefetcher = FramePrefetcher(source, buffer_bytes=4 * frame_bytes(10))
    prefetcher.get(0)
    assert prefetcher.frames_ahead == 0
    source.gate.set()
    eventually(lambda: prefetcher.frames_ahead == 3)
    prefetcher.get(2, -1, wait=True)
    eventually(lambda: prefetcher.frames_ahead == 3)
    prefetcher.close()


@pytest.mark.parametrize("frames", [1, 3])
def test_a_fully_buffered_scene_has_all_other_frames_ahead(frames: int) -> None:
    """Catches a count of buffered frames that includes the current frame if the whole scene is buffered."""
    source = CountedSource([10] * frames)
    prefetcher = FramePrefetcher(source)
    for index in [*range(frames), 0]:
        prefetcher.get(index, wait=True)
    assert prefetcher.frames_ahead == frames - 1
    prefetcher.close()


@pytest.mark.parametrize("kind", ["checksum", "numbers"])
def test_a_damaged_frame_raises_and_the_others_load(tmp_path: Path, kind: str) -> None:
    """Catches a prefetch thread that ends because of a damaged frame, and NaN that reaches a renderer."""
    path = tmp_path / "scene.4dv"
    written = write_damaged_scene(path, kind)
    prefetcher = FramePrefetcher(SceneReader(path))
    for _ in range(2):
        with pytest.raises(UserError, match=f"{re.escape(str(path))}: expected .*{MEMBER}"):
            prefetcher.get(1, wait=True)
        assert_same(prefetcher.get(2, wait=True), written[2])
        assert_same(prefetcher.get(0, wait=True), written[0])
    with pytest.raises(UserError):
        prefetcher.get(1)
    prefetcher.close()


def test_repeated_errors_use_no_memory(tmp_path: Path) -> None:
    """Catches an exception whose traceback grows every time the exception is raised again."""
    path = tmp_path / "scene.4dv"
    write_damaged_scene(path, "numbers")
    prefetcher = FramePrefetcher(SceneReader(path))
    lengths = []
    for _ in range(20):
        with pytest.raises(UserError) as raised:
            prefetcher.get(1, wait=True)
        lengths.append(len(raised.traceback))
    assert lengths[-1] == lengths[0]
    prefetcher.close()


def test_an_unexpected_error_reaches_the_caller() -> None:
    """Catches a caller that waits forever because the prefetch thread has failed."""
    source = CountedSource([10] * 3)
    source.failures[0] = RuntimeError("no such tensor")
    prefetcher = FramePrefetcher(source)
    with pytest.raises(RuntimeError, match="no such tensor"):
        prefetcher.get(0, wait=True)
    with pytest.raises(RuntimeError, match="no such tensor"):
        prefetcher.get(1)
    prefetcher.close()
    assert source.close_count == 1


def test_invalidation_reads_all_frames_again() -> None:
    """Catches buffered frames and errors that remain after the source has changed."""
    source = CountedSource([10] * 3)
    source.failures[1] = UserError("a.4dv: the file is damaged")
    prefetcher = FramePrefetcher(source)
    assert_same(prefetcher.get(0, wait=True), source.frame(0))
    with pytest.raises(UserError, match="damaged"):
        prefetcher.get(1, wait=True)
    reads_at_rest(source, 3)
    source.failures.clear()
    source.seed = 1
    prefetcher.invalidate()
    for index in range(3):
        assert_same(prefetcher.get(index, wait=True), source.frame(index))
    assert len(source.reads) == 6
    prefetcher.close()


def test_a_read_during_invalidation_is_dropped() -> None:
    """Catches a frame of an old checkpoint in the buffer of the new checkpoint."""
    source = CountedSource([10] * 3)
    source.gate.clear()
    prefetcher = FramePrefetcher(source)
    assert prefetcher.get(0) is None
    assert source.has_started.wait(10)
    source.seed = 1
    prefetcher.invalidate()
    source.gate.set()
    assert_same(prefetcher.get(0, wait=True), source.frame(0))
    assert reads_at_rest(source, 4) == [0, 0, 1, 2]
    assert_same(prefetcher.get(2, wait=True), source.frame(2))
    prefetcher.close()


@pytest.mark.parametrize("has_read", [False, True])
def test_closing_stops_the_thread_and_closes_the_source(has_read: bool) -> None:
    """Catches a thread or an open file that remains after a scene is closed."""
    before = set(threading.enumerate())
    source = CountedSource([10] * 3)
    prefetcher = FramePrefetcher(source)
    assert len(set(threading.enumerate()) - before) == 1
    if has_read:
        prefetcher.get(0, wait=True)
    prefetcher.close()
    assert set(threading.enumerate()) <= before
    assert source.close_count == 1
    assert source.alive == []


def test_closing_waits_for_the_current_read() -> None:
    """Catches a scene file that is closed while the prefetch thread reads it."""
    source = CountedSource([10] * 3)
    source.gate.clear()
    prefetcher = FramePrefetcher(source)
    prefetcher.get(0)
    assert source.has_started.wait(10)
    closing = threading.Thread(target=prefetcher.close)
    closing.start()
    time.sleep(0.01)
    assert source.close_count == 0
    source.gate.set()
    closing.join(10)
    assert source.close_count == 1
    assert source.reads == [0]
