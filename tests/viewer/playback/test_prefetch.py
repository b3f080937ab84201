"""Frames read ahead: the right ones, in order, in bounded memory, and with their errors."""

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

from fourd.baking import BakedFrame, SceneBackground, SceneManifest, SceneReader
from fourd.baking.container import member_name
from fourd.errors import UserError
from fourd.viewer.playback.prefetch import FramePrefetcher
from tests.baking.scenes import manifest, random_frame, write_scene

VIEWS = 2
MEMBER = member_name(1, "xyz")


class CountedSource:
    """Frames of given numbers of points, made anew each time, so that their lives can be followed.

    Attributes:
        room: bytes that the frames in memory may take when another is read, unless they are two.
        reads: which frames were read.
        most_kept: how many frames were in memory at most when another was read.
        gate: reading waits for it.
        begun: that a reading has come to the gate.
        failures: what to raise instead of frames.
        seed: of the frames' content.
        closed: how many times.
    """

    def __init__(self, points: list[int], room: int = 1 << 40) -> None:
        self.points, self.room = points, room
        self.manifest: SceneManifest = manifest(VIEWS, len(points))
        self.reads: list[int] = []
        self.most_kept = 0
        self.gate, self.begun = threading.Event(), threading.Event()
        self.gate.set()
        self.failures: dict[int, Exception] = {}
        self.seed = 0
        self.closed = 0
        self._sizes: dict[int, int] = {}

    @property
    def kept(self) -> list[int]:
        """Sizes of the frames that are still in memory."""
        return list(self._sizes.values())

    def read(self, index: int) -> BakedFrame:
        kept = self.kept
        assert len(kept) <= 2 or sum(kept) <= self.room, "more is kept than there is room for"
        self.most_kept = max(self.most_kept, len(kept))
        self.reads.append(index)
        if index in self.failures:
            raise self.failures[index]
        frame = self.frame(index)
        number = len(self.reads)
        self._sizes[number] = frame.nbytes
        weakref.finalize(frame, self._sizes.pop, number)
        self.begun.set()
        assert self.gate.wait(10)
        return frame

    def frame(self, index: int) -> BakedFrame:
        """What a frame holds."""
        return random_frame(self.points[index], VIEWS, seed=100 * self.seed + index)

    def close(self) -> None:
        self.closed += 1


def frame_bytes(points: int) -> int:
    return random_frame(points, VIEWS, seed=0).nbytes


def eventually(condition: Callable[[], bool]) -> None:
    """Let other threads go on until it holds."""
    for _ in range(2000):
        if condition():
            return
        time.sleep(0.002)
    raise AssertionError("it never came")


def rest(source: CountedSource, count: int) -> list[int]:
    """What was read once ``count`` frames were, and nothing more comes."""
    eventually(lambda: len(source.reads) >= count)
    time.sleep(0.02)
    return source.reads


def assert_same(got: BakedFrame | None, expected: BakedFrame) -> None:
    assert got is not None
    for attribute in expected.attributes:
        np.testing.assert_array_equal(getattr(got, attribute.name), getattr(expected, attribute.name))


def place_of(path: Path, name: str) -> tuple[int, int]:
    """Where a member's bytes lie in the file, and how many they are."""
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo(name)
    header = path.read_bytes()[info.header_offset : info.header_offset + 30]
    lengths = int.from_bytes(header[26:28], "little") + int.from_bytes(header[28:30], "little")
    return info.header_offset + 30 + lengths, info.file_size


def overwrite(path: Path, offset: int, content: bytes) -> None:
    """Change bytes of a file in place."""
    with path.open("rb+") as stream:
        stream.seek(offset)
        stream.write(content)


def damaged_scene(path: Path, kind: str) -> list[BakedFrame]:
    """A scene whose frame 1 has NaN in it: with a checksum that fails, or with one that fits."""
    written = write_scene(path)
    offset, size = place_of(path, MEMBER)
    spoilt = np.full(size // 4, np.nan, "<f4").tobytes()
    if kind == "checksum":
        overwrite(path, offset, spoilt)
        return written
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, spoilt if name == MEMBER else content)
    return written


def test_frames_are_those_of_the_file(tmp_path: Path) -> None:
    """Catches frames given under another's number, forwards, backwards, in jumps and round the end."""
    written = write_scene(tmp_path / "scene.4dv", frames=5)
    stream = FramePrefetcher(SceneReader(tmp_path / "scene.4dv"), buffer_bytes=2 * written[-1].nbytes)
    for index, direction in [
        *((i % 5, 1) for i in range(11)),
        *((i % 5, -1) for i in range(10, 2, -1)),
        (1, 1),
        (4, 1),
    ]:
        assert_same(stream.get(index, direction, wait=True), written[index])
    stream.close()


@pytest.mark.parametrize(
    ("head", "direction", "order"),
    [(0, 1, [0, 1, 2, 3, 4]), (3, 1, [3, 4, 0, 1, 2]), (4, -1, [4, 3, 2, 1, 0]), (1, -1, [1, 0, 4, 3, 2])],
)
def test_reading_ahead_follows_the_direction(head: int, direction: int, order: list[int]) -> None:
    """Catches reading towards what was just shown, a stop at the scene's end, and frames read twice."""
    source = CountedSource([10] * 5)
    stream = FramePrefetcher(source)
    stream.get(head, direction)
    assert rest(source, 5) == order
    stream.close()


def test_nothing_is_read_before_a_frame_is_asked_for() -> None:
    """Catches a start at frame 0 where another is shown first."""
    source = CountedSource([10] * 5)
    stream = FramePrefetcher(source)
    assert rest(source, 0) == []
    stream.close()


def test_a_turn_reads_what_comes_next_now() -> None:
    """Catches a ring that stays behind when playback turns round, and one that reads again what it has."""
    source = CountedSource([10] * 10)
    stream = FramePrefetcher(source, buffer_bytes=3 * frame_bytes(10))
    stream.get(5, 1)
    assert rest(source, 3) == [5, 6, 7]
    stream.get(5, -1)
    assert rest(source, 5) == [5, 6, 7, 4, 3]
    assert stream.get(4, -1) is not None
    assert rest(source, 6)[5:] == [2]
    stream.close()


@pytest.mark.parametrize("room", [0, 1, frame_bytes(10), 2 * frame_bytes(10), 5 * frame_bytes(10) - 1])
def test_only_frames_that_fit_are_kept(room: int) -> None:
    """Catches memory that grows while a scene plays, and less than two frames, which would stop playback."""
    source = CountedSource([10] * 12)
    stream = FramePrefetcher(source, buffer_bytes=room)
    fitting = max(2, room // frame_bytes(10))
    for index in [0, 1, 2, 3, 9, 10, 11, 0, 1]:
        stream.get(index, wait=True)
        eventually(lambda: stream.frames_ahead == fitting - 1)
        eventually(lambda: len(source.kept) == fitting)
    assert source.most_kept == fitting
    stream.close()


def test_frames_of_different_sizes_fit_together() -> None:
    """Catches room counted in small frames that large ones then fill."""
    rng = np.random.default_rng(3)
    room = 3 * frame_bytes(400)
    source = CountedSource([int(points) for points in rng.integers(1, 400, 30)], room)
    stream = FramePrefetcher(source, buffer_bytes=room)
    for index in range(60):
        assert_same(stream.get(index % 30, wait=True), source.frame(index % 30))
    stream.close()


def test_a_background_takes_room_too() -> None:
    """Catches memory that is given to frames and is the background's already."""
    source = CountedSource([10] * 12)
    source.manifest = replace(source.manifest, kind="full", background=SceneBackground(30))
    stream = FramePrefetcher(source, buffer_bytes=5 * frame_bytes(10) + frame_bytes(30) - 1)
    stream.get(0, wait=True)
    rest(source, 4)
    assert (stream.frames_ahead, len(source.kept)) == (3, 4)
    stream.close()


def test_a_large_frame_ahead_is_not_read_over_and_over() -> None:
    """Catches a disk that never rests: a large frame drops out for its size, and is then wanted again."""
    source = CountedSource([10] * 5 + [100] + [10] * 14)
    stream = FramePrefetcher(source, buffer_bytes=3 * frame_bytes(100))
    stream.get(0, wait=True)
    time.sleep(0.04)
    stream.close()
    assert len(source.reads) <= 2 * len(source.points)


def test_a_frame_comes_once_it_is_read() -> None:
    """Catches a viewer that is blocked by a slow disk, and a frame that is read anew at every settings."""
    source = CountedSource([10] * 3)
    source.gate.clear()
    stream = FramePrefetcher(source)
    assert stream.get(1) is None
    assert source.begun.wait(10)
    assert stream.get(1) is None
    source.gate.set()
    frame = stream.get(1, wait=True)
    assert_same(frame, source.frame(1))
    assert stream.get(1) is frame
    assert sorted(rest(source, 3)) == [0, 1, 2]
    stream.close()


def test_how_many_frames_are_ahead() -> None:
    """Catches a count that includes the frame shown, or that looks the wrong way or over a gap."""
    source = CountedSource([10] * 6)
    source.gate.clear()
    stream = FramePrefetcher(source, buffer_bytes=4 * frame_bytes(10))
    stream.get(0)
    assert stream.frames_ahead == 0
    source.gate.set()
    eventually(lambda: stream.frames_ahead == 3)
    stream.get(2, -1, wait=True)
    eventually(lambda: stream.frames_ahead == 3)
    stream.close()


@pytest.mark.parametrize("frames", [1, 3])
def test_a_scene_that_is_read_as_a_whole_is_ahead_by_all_others(frames: int) -> None:
    """Catches a frame that counts as ahead of itself."""
    source = CountedSource([10] * frames)
    stream = FramePrefetcher(source)
    for index in [*range(frames), 0]:
        stream.get(index, wait=True)
    assert stream.frames_ahead == frames - 1
    stream.close()


@pytest.mark.parametrize("kind", ["checksum", "numbers"])
def test_a_damaged_frame_is_told_and_the_others_come(tmp_path: Path, kind: str) -> None:
    """Catches a thread that dies of a damaged frame, and NaN that reaches a renderer."""
    path = tmp_path / "scene.4dv"
    written = damaged_scene(path, kind)
    stream = FramePrefetcher(SceneReader(path))
    for _ in range(2):
        with pytest.raises(UserError, match=f"{re.escape(str(path))}: expected .*{MEMBER}"):
            stream.get(1, wait=True)
        assert_same(stream.get(2, wait=True), written[2])
        assert_same(stream.get(0, wait=True), written[0])
    with pytest.raises(UserError):
        stream.get(1)
    stream.close()


def test_a_damaged_frame_costs_no_memory_while_it_is_shown(tmp_path: Path) -> None:
    """Catches an error whose traceback grows with every picture for which it is raised."""
    path = tmp_path / "scene.4dv"
    damaged_scene(path, "numbers")
    stream = FramePrefetcher(SceneReader(path))
    lengths = []
    for _ in range(20):
        with pytest.raises(UserError) as raised:
            stream.get(1, wait=True)
        lengths.append(len(raised.traceback))
    assert lengths[-1] == lengths[0]
    stream.close()


def test_an_unforeseen_error_reaches_the_caller() -> None:
    """Catches a viewer that waits for ever for a thread that has died."""
    source = CountedSource([10] * 3)
    source.failures[0] = RuntimeError("no such tensor")
    stream = FramePrefetcher(source)
    with pytest.raises(RuntimeError, match="no such tensor"):
        stream.get(0, wait=True)
    with pytest.raises(RuntimeError, match="no such tensor"):
        stream.get(1)
    stream.close()
    assert source.closed == 1


def test_forgetting_reads_again() -> None:
    """Catches old frames, and old errors, that stay after a source has changed."""
    source = CountedSource([10] * 3)
    source.failures[1] = UserError("a.4dv: the file is damaged")
    stream = FramePrefetcher(source)
    assert_same(stream.get(0, wait=True), source.frame(0))
    with pytest.raises(UserError, match="damaged"):
        stream.get(1, wait=True)
    rest(source, 3)
    source.failures.clear()
    source.seed = 1
    stream.invalidate()
    for index in range(3):
        assert_same(stream.get(index, wait=True), source.frame(index))
    assert len(source.reads) == 6
    stream.close()


def test_what_is_read_while_it_is_forgotten_does_not_come_back() -> None:
    """Catches the frame of an old checkpoint that is taken for the new one's."""
    source = CountedSource([10] * 3)
    source.gate.clear()
    stream = FramePrefetcher(source)
    assert stream.get(0) is None
    assert source.begun.wait(10)
    source.seed = 1
    stream.invalidate()
    source.gate.set()
    assert_same(stream.get(0, wait=True), source.frame(0))
    assert rest(source, 4) == [0, 0, 1, 2]
    assert_same(stream.get(2, wait=True), source.frame(2))
    stream.close()


@pytest.mark.parametrize("asked", [False, True])
def test_closing_ends_the_thread_and_the_source(asked: bool) -> None:
    """Catches threads and open files that stay with every scene that was looked at."""
    before = set(threading.enumerate())
    source = CountedSource([10] * 3)
    stream = FramePrefetcher(source)
    assert len(set(threading.enumerate()) - before) == 1
    if asked:
        stream.get(0, wait=True)
    stream.close()
    assert set(threading.enumerate()) <= before
    assert source.closed == 1
    assert source.kept == []


def test_closing_waits_for_what_is_being_read() -> None:
    """Catches a file that is closed under the reading thread's hands."""
    source = CountedSource([10] * 3)
    source.gate.clear()
    stream = FramePrefetcher(source)
    stream.get(0)
    assert source.begun.wait(10)
    closing = threading.Thread(target=stream.close)
    closing.start()
    time.sleep(0.01)
    assert source.closed == 0
    source.gate.set()
    closing.join(10)
    assert source.closed == 1
    assert source.reads == [0]
