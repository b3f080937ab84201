"""Frame n of a video is the n-th picture that is shown, in every container and codec, in any order of reading."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from av.packet import Packet

from fourd.base.errors import UserError
from fourd.base.processes.isolation import ParserProcess
from fourd.recording.capture.streams.index import VideoIndex
from fourd.recording.capture.video import VideoReader, index_video
from tests.capture.streams.coded_videos import (
    CODECS,
    FPS,
    PAIRS,
    SIZE,
    TICKS,
    Coding,
    copy_packets,
    number_of,
    numbered_picture,
    open_output,
    options_of,
    write,
)

NUMBERS = range(60)
CODINGS = {
    "b-frames": Coding(),
    "open": Coding(is_open=True),
    "sparse": Coding(interval=1000),
    "dense": Coding(interval=1, b_frames=0),
    "no-b-frames": Coding(b_frames=0),
    "refresh": Coding(b_frames=0, has_refresh=True),
}
CODINGS_OF = dict.fromkeys(CODECS, ("b-frames", "open", "sparse", "dense", "no-b-frames")) | {
    "h264": tuple(CODINGS),
    "vp9": ("b-frames", "sparse", "dense", "no-b-frames"),
    "mjpeg": ("dense",),
    "prores": ("dense",),
}
"""The codings of which each codec is capable. VP9 has no open groups of pictures in FFmpeg's encoder."""
TABLE = [(container, codec, coding) for container, codec in PAIRS for coding in CODINGS_OF[codec]]
CORE = {
    ("mp4", "h264", "b-frames"),
    ("mp4", "h264", "refresh"),
    ("mov", "hevc", "open"),
    ("mov", "prores", "dense"),
    ("mkv", "av1", "b-frames"),
    ("webm", "vp9", "b-frames"),
    ("avi", "h264", "b-frames"),
    ("avi", "mjpeg", "dense"),
    ("ts", "h264", "open"),
    ("mts", "hevc", "b-frames"),
    ("m2ts", "h264", "sparse"),
    ("mpg", "mpeg2video", "open"),
}


@pytest.fixture(scope="module")
def parser() -> Iterator[ParserProcess]:
    with ParserProcess() as process:
        yield process


def check(path: Path, expected: Sequence[int], parser: ParserProcess, rng: np.random.Generator) -> VideoIndex:
    """Check that the video shows the expected numbers, in order, backwards and at random. Returns its index."""
    index = index_video(path, parser)
    count = len(expected)
    orders = {
        "in order": list(range(count)),
        "backwards": list(range(count))[::-1],
        "at random": rng.permutation(count).tolist(),
    }
    assert index.frames == count
    for name, order in orders.items():
        with VideoReader(path, index, 1) as reader:
            found = [number_of(reader.read(frame)) for frame in order]
        assert found == [expected[frame] for frame in order], name
    return index


@pytest.mark.parametrize(
    ("container", "codec", "coding"),
    [case if case in CORE else pytest.param(*case, marks=pytest.mark.slow) for case in TABLE],
)
def test_frames_of_all_containers(
    container: str, codec: str, coding: str, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator
) -> None:
    """Catches a wrong frame after a seek, and frames that are counted in the order of the file."""
    path = write(tmp_path / f"a.{container}", codec, NUMBERS, CODINGS[coding])
    index = check(path, NUMBERS, parser, rng)
    assert index.fps == FPS
    assert not index.times


def test_core_is_in_the_table() -> None:
    """Catches a core case that is not run because of a spelling mistake."""
    assert set(TABLE) >= CORE


@pytest.mark.parametrize("container", ["mp4", "mkv", "ts"])
def test_uneven_times(container: str, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator) -> None:
    """Catches frames that are counted by their times at a constant rate."""
    ticks = 90 * np.cumsum(rng.integers(20, 90, len(NUMBERS)))
    path = write(tmp_path / f"a.{container}", "h264", NUMBERS, times=ticks.tolist(), base=Fraction(1, TICKS))
    index = check(path, NUMBERS, parser, rng)
    assert np.allclose(np.diff([float(index.elapsed(n)) for n in NUMBERS]), np.diff(ticks) / TICKS, atol=2e-3)


@pytest.mark.parametrize("container", ["mp4", "mov", "mkv", "ts", "m2ts"])
def test_late_starts(container: str, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator) -> None:
    """Catches frames that are counted from the time 0."""
    times = [number + 500 for number in NUMBERS]
    check(write(tmp_path / f"a.{container}", "h264", NUMBERS, times=times), NUMBERS, parser, rng)


def shifted(packets: list[Packet], ticks: int) -> list[Packet]:
    for packet in packets:
        packet.pts, packet.dts = packet.pts + ticks, packet.dts + ticks
    return packets


@pytest.mark.parametrize("container", ["mp4", "mov"])
@pytest.mark.parametrize("cut", [1, 5, 15])
def test_edit_lists(container: str, cut: int, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator) -> None:
    """Catches frames that the edit list of an MP4 file cuts off, but that are counted."""
    whole = write(tmp_path / "whole.mp4", "h264", NUMBERS)
    options = {"avoid_negative_ts": "disabled", "use_editlist": "1"}
    with av.open(str(whole)) as video:
        base = video.streams.video[0].time_base
    assert base is not None
    frame = round(1 / (FPS * base))
    path = copy_packets(whole, tmp_path / f"a.{container}", lambda of: shifted(of, -cut * frame), options=options)
    check(path, NUMBERS[cut:], parser, rng)


@pytest.mark.parametrize("b_frames", [0, 2])
@pytest.mark.parametrize("codec", ["h264", "mjpeg", "mpeg4"])
def test_null_frames(
    codec: str, b_frames: int, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator
) -> None:
    """Catches an empty packet of an AVI file that ends the video, counts as a frame, or gives later frames the wrong
    time."""
    times = [number + 3 * (number > 20) + (number > 40) for number in NUMBERS]
    path = write(tmp_path / "a.avi", codec, NUMBERS, Coding(b_frames=b_frames), times=times)
    index = check(path, NUMBERS, parser, rng)
    found = np.array([float(index.elapsed(number)) * FPS for number in NUMBERS])
    assert np.abs(found - times).max() <= (0.01 if codec == "mjpeg" or not b_frames else b_frames + 2.01)
    assert found[-1] == pytest.approx(times[-1], abs=0.01)


def drop(count: int) -> Callable[[list[Packet]], list[Packet]]:
    return lambda packets: packets[count:]


@pytest.mark.parametrize("is_open", [False, True])
@pytest.mark.parametrize("codec", ["h264", "hevc", "mpeg2video"])
@pytest.mark.parametrize("container", ["mp4", "mkv", "ts", "avi"])
def test_starts_without_a_keyframe(
    container: str, codec: str, is_open: bool, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator
) -> None:
    """Catches grey or broken frames at the start of a recording that is cut from a longer one."""
    if (container, codec) == ("avi", "hevc"):
        pytest.skip("FFmpeg writes no HEVC into AVI")
    if container in ("ts", "avi") and codec == "h264" and is_open:
        pytest.skip("FFmpeg repeats the parameter sets of H.264 only before keyframes of closed groups")
    whole = write(tmp_path / f"whole.{'avi' if container == 'avi' else 'mkv'}", codec, NUMBERS, Coding(is_open=is_open))
    path = copy_packets(whole, tmp_path / f"a.{container}", drop(5))
    index = index_video(path, parser)
    first = len(NUMBERS) - index.frames
    assert 10 <= first <= 13
    check(path, NUMBERS[first:], parser, rng)


@pytest.mark.parametrize("flag", [True, False])
@pytest.mark.parametrize("codec", ["h264", "hevc", "vp9", "mpeg4", "mpeg2video"])
@pytest.mark.parametrize("container", ["mp4", "mkv"])
def test_wrong_keyframe_flags(
    container: str, codec: str, flag: bool, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator
) -> None:
    """Catches a seek to a frame that is not a keyframe although the container says so, and keyframes without a mark."""

    def mark(packets: list[Packet]) -> list[Packet]:
        for packet in packets:
            packet.is_keyframe = flag
        return packets

    whole = write(tmp_path / "whole.mkv", codec, NUMBERS)
    check(copy_packets(whole, tmp_path / f"a.{container}", mark), NUMBERS, parser, rng)


@pytest.mark.parametrize("codec", ["h264", "mpeg2video"])
def test_times_that_wrap(codec: str, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator) -> None:
    """Catches times of MPEG-TS, which start again at 0 after 26.5 hours, that are not continued."""
    whole = write(tmp_path / "whole.ts", codec, NUMBERS)
    path = copy_packets(whole, tmp_path / "a.ts", lambda of: shifted(of, (1 << 33) - 4 * TICKS))
    index = check(path, NUMBERS, parser, rng)
    assert index.fps == FPS
    assert not index.times


def test_shared_times(tmp_path: Path, parser: ParserProcess, rng: np.random.Generator) -> None:
    """Catches two frames of the same time that count as one."""

    def share(packets: list[Packet]) -> list[Packet]:
        for number in (11, 12, 40):
            packets[number].pts = packets[number].dts = packets[number - 1].pts
        return packets

    whole = write(tmp_path / "whole.mkv", "h264", NUMBERS, Coding(b_frames=0))
    check(copy_packets(whole, tmp_path / "a.mkv", share), NUMBERS, parser, rng)


@pytest.mark.parametrize(
    ("codec", "container"), [("libvpx", "webm"), ("libvpx", "mkv"), ("mpeg4", "avi"), ("mpeg4", "mkv")]
)
def test_older_codecs(
    codec: str, container: str, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator
) -> None:
    """Catches hidden frames of VP8 that are counted, and B-frames of MPEG-4 that are read in the order of the file."""

    def prepare(stream: av.VideoStream) -> None:
        hidden = {"auto-alt-ref": "1", "lag-in-frames": "10", "g": "20", "crf": "5", "b": "2000000"}
        stream.options = hidden if codec == "libvpx" else {"g": "12", "bf": "2", "b": "2000000"}

    path = write(tmp_path / f"a.{container}", codec, NUMBERS, prepare=prepare)
    check(path, NUMBERS, parser, rng)


MUXINGS = [
    ("mp4", {"movflags": "frag_keyframe+empty_moov"}),
    ("mp4", {"movflags": "frag_every_frame+empty_moov+default_base_moof"}),
    ("mp4", {"movflags": "faststart"}),
    ("mp4", {"movflags": "negative_cts_offsets"}),
    ("mov", {"use_editlist": "0"}),
    ("mkv", {"live": "1"}),
    ("mkv", {"cluster_size_limit": "500"}),
    ("ts", {"muxrate": "2000000"}),
    ("ts", {"mpegts_flags": "resend_headers", "pes_payload_size": "500"}),
]


@pytest.mark.parametrize(("container", "options"), MUXINGS)
def test_ways_of_muxing(
    container: str, options: dict[str, str], tmp_path: Path, parser: ParserProcess, rng: np.random.Generator
) -> None:
    """Catches seeks that rely on an index of the container, and offsets of times that are ignored."""
    check(write(tmp_path / f"a.{container}", "h264", NUMBERS, options=options), NUMBERS, parser, rng)


@pytest.mark.parametrize("container", ["mp4", "mkv", "avi", "ts", "m2ts"])
def test_sound_between_the_frames(
    container: str, tmp_path: Path, parser: ParserProcess, rng: np.random.Generator
) -> None:
    """Catches packets of sound that count as frames."""
    path = tmp_path / f"a.{container}"
    with open_output(path) as output:
        sound = output.add_stream("mp2", rate=48000)
        sound.layout = "mono"
        video = output.add_stream("libx264", rate=FPS, options=options_of("h264", Coding()))
        video.width = video.height = SIZE
        for number in NUMBERS:
            samples = rng.integers(-9000, 9000, (1, 48000 // FPS)).astype(np.int16)
            heard = av.AudioFrame.from_ndarray(samples, format="s16", layout="mono")
            heard.sample_rate, heard.pts, heard.time_base = 48000, number * 48000 // FPS, Fraction(1, 48000)
            output.mux(sound.encode(heard))
            frame = av.VideoFrame.from_ndarray(numbered_picture(number), format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, FPS)
            output.mux(video.encode(frame))
        output.mux(sound.encode(None))
        output.mux(video.encode(None))
    check(path, NUMBERS, parser, rng)


@pytest.mark.parametrize("container", ["mp4", "mkv", "avi", "ts", "m2ts"])
def test_cut_files_are_refused(container: str, tmp_path: Path, parser: ParserProcess) -> None:
    """Catches an interrupted copy of a file that counts its frames in the header."""
    options = {"movflags": "faststart"} if container == "mp4" else {}
    path = write(tmp_path / f"a.{container}", "h264", NUMBERS, options=options)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 4 // 5 // 192 * 192 + 100])
    with pytest.raises(UserError, match=r"expected .*(frames|bytes).*, got .*; copy or record the video again"):
        index_video(path, parser)


def detailed_picture(number: int) -> np.ndarray:
    noise = np.random.default_rng(number).integers(-20, 20, (192, 192, 1))
    enlarged = np.kron(numbered_picture(number), np.ones((3, 3, 1))) + noise
    return np.asarray(np.clip(enlarged, 0, 255), np.uint8)


@pytest.mark.parametrize(
    ("container", "codec"), [("mp4", "h264"), ("mkv", "h264"), ("ts", "h264"), ("ts", "hevc"), ("avi", "mjpeg")]
)
def test_damage_names_the_frame(container: str, codec: str, tmp_path: Path, parser: ParserProcess) -> None:
    """Catches a damaged place in the middle of a video that is filled with parts of other frames."""
    path = write(tmp_path / f"a.{container}", codec, NUMBERS, Coding(b_frames=0), make=detailed_picture)
    with av.open(str(path)) as video:
        packet = [packet for packet in video.demux(video=0) if packet.size][39]
    content, start = bytearray(path.read_bytes()), packet.pos or 0
    if container == "ts":
        del content[start + 2 * 188 : start + 4 * 188]
    else:
        middle = start + packet.size // 2
        content[middle : middle + 60] = b"\xff" * 60
    path.write_bytes(content)

    def read_all() -> None:
        with VideoReader(path, index_video(path, parser), 1) as reader:
            for frame in NUMBERS:
                assert number_of(reader.read(frame)[::3, ::3]) == frame

    with pytest.raises(UserError, match=r"expected frame (38|39) to be whole, got .*; copy or record the video"):
        read_all()
