"""Which video stream of a file is read, what its frames look like, and interlaced video."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from av.stream import Disposition

from fourd.base.errors import UserError
from fourd.base.processes.isolation import ParserProcess
from fourd.recording.capture.streams.interlacing import CombCounter
from fourd.recording.capture.video import VideoReader, first_frame, index_video
from tests.capture.streams.coded_videos import FPS, Coding, number_of, numbered_picture, open_output, write

NUMBERS = range(12)


@pytest.fixture(scope="module")
def parser() -> Iterator[ParserProcess]:
    with ParserProcess() as process:
        yield process


def add_stream(container: Any, codec: str, size: tuple[int, int], disposition: Disposition | None = None) -> Any:
    stream = container.add_stream(codec, rate=FPS)
    stream.width, stream.height = size
    stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    if disposition is not None:
        stream.disposition = disposition
    return stream


def mux(container: Any, stream: Any, pictures: list[np.ndarray]) -> None:
    for number, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
        frame.pts, frame.time_base = number, Fraction(1, FPS)
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))


def boxes(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    while content:
        size = struct.unpack(">I", content[:4])[0]
        yield content[4:8], content[:size]
        content = content[size:]


def write_with_cover(path: Path) -> Path:
    """Write an MP4 whose cover picture, which is larger than the video, is the first video stream of the file."""
    with open_output(path) as container:
        video = add_stream(container, "libx264", (64, 64))
        cover = add_stream(container, "mjpeg", (320, 240), Disposition.attached_pic)
        mux(container, cover, [np.full((240, 320, 3), 90, np.uint8)])
        mux(container, video, [numbered_picture(number) for number in NUMBERS])
    top = list(boxes(path.read_bytes()))
    moov = next(box for kind, box in top if kind == b"moov")
    order = (b"mvhd", b"udta", b"trak")
    parts = sorted(boxes(moov[8:]), key=lambda part: order.index(part[0]))
    changed = moov[:8] + b"".join(box for _, box in parts)
    path.write_bytes(b"".join(changed if kind == b"moov" else box for kind, box in top))
    with av.open(str(path)) as container:
        assert container.streams.video[0].codec_context.name == "mjpeg"
    return path


def test_covers_are_not_the_video(tmp_path: Path, parser: ParserProcess) -> None:
    """Catches a cover picture that is read as the video, since it is the first video stream of the file."""
    path = write_with_cover(tmp_path / "a.mp4")
    index = index_video(path, parser)
    assert (index.frames, index.width, index.height, index.notes) == (12, 64, 64, ())
    assert first_frame(path)[:2] == (64, 64)
    with VideoReader(path, index) as reader:
        assert [number_of(reader.read(frame)) for frame in (11, 0, 5)] == [11, 0, 5]


@pytest.mark.parametrize("container", ["mp4", "mkv", "ts"])
def test_the_largest_stream_is_read(container: str, tmp_path: Path, parser: ParserProcess) -> None:
    """Catches a preview stream that is read instead of the recording, and a choice without a word."""
    path = tmp_path / f"a.{container}"
    with open_output(path) as output:
        small = add_stream(output, "libx264", (48, 48))
        large = add_stream(output, "libx264", (64, 64))
        mux(output, small, [np.full((48, 48, 3), 90, np.uint8)] * 20)
        mux(output, large, [numbered_picture(number) for number in NUMBERS])
    index = index_video(path, parser)
    assert index.notes == ("the largest of 2 video streams is used (64 x 64; others: 48 x 48)",)
    with VideoReader(path, index) as reader:
        assert [number_of(reader.read(frame)) for frame in (11, 0, 5)] == [11, 0, 5]


def test_a_cover_alone_is_refused(tmp_path: Path, parser: ParserProcess) -> None:
    """Catches a sound file with a cover picture that is read as a video."""
    path = tmp_path / "a.mkv"
    with open_output(path) as output:
        sound = output.add_stream("pcm_s16le", rate=8000)
        output.add_attachment("cover.jpg", "image/jpeg", write(tmp_path / "c.mkv", "mjpeg", [1, 2]).read_bytes())
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        output.mux(sound.encode(frame))
    with pytest.raises(UserError, match=r"a.mkv: expected a video, got .*; remove the file"):
        index_video(path, parser)


def with_aspect(aspect: Fraction) -> Any:
    def prepare(stream: Any) -> None:
        stream.codec_context.sample_aspect_ratio = aspect

    return prepare


@pytest.mark.parametrize(
    ("aspect", "size"), [(Fraction(4, 3), (85, 64)), (Fraction(3, 4), (64, 85)), (Fraction(1001, 1000), (64, 64))]
)
@pytest.mark.parametrize("container", ["mp4", "mkv", "ts"])
def test_frames_have_square_pixels(
    container: str, aspect: Fraction, size: tuple[int, int], tmp_path: Path, parser: ParserProcess
) -> None:
    """Catches frames with non-square pixels that are used as they are stored, and so are squeezed."""
    path = write(tmp_path / f"a.{container}", "h264", NUMBERS, prepare=with_aspect(aspect))
    index = index_video(path, parser)
    assert (index.width, index.height) == size
    assert first_frame(path)[:2] == size
    with VideoReader(path, index) as reader:
        picture = reader.read(7)
    assert picture.shape == (size[1], size[0], 3)
    assert number_of(picture[np.arange(64) * size[1] // 64][:, np.arange(64) * size[0] // 64]) == 7


def test_impossible_pixels_are_refused(tmp_path: Path, parser: ParserProcess) -> None:
    """Catches frames that are stretched to a line because of damaged metadata."""
    path = write(tmp_path / "a.mp4", "h264", NUMBERS, prepare=with_aspect(Fraction(50)))
    with pytest.raises(UserError, match=r"expected pixels that are at most 4 times as wide .*got .* 50:1; make the"):
        index_video(path, parser)


ALPHA = [
    ("a.mov", "prores", "yuva444p10le"),
    ("a.mov", "qtrle", "argb"),
    ("a.mov", "png", "rgba"),
    ("a.webm", "vp9", "yuva420p"),
    ("a.webm", "libvpx", "yuva420p"),
]


@pytest.mark.parametrize(("name", "codec", "pixels"), ALPHA)
def test_hidden_colours_are_not_used(name: str, codec: str, pixels: str, tmp_path: Path, parser: ParserProcess) -> None:
    """Catches the colours of transparent pixels, which nobody has seen, in the frames of a video."""

    def make(number: int) -> av.VideoFrame:
        rgba = np.concatenate([numbered_picture(number), np.full((64, 64, 1), 255, np.uint8)], axis=2)
        rgba[:16, :, 3] = 0
        return av.VideoFrame.from_ndarray(np.ascontiguousarray(rgba), format="rgba").reformat(format=pixels)

    def prepare(stream: Any) -> None:
        if name == "a.webm":
            stream.options = {"auto-alt-ref": "0", "crf": "5", "b": "2000000", "g": "4"}

    path = write(tmp_path / name, codec, NUMBERS, pix_fmt=pixels, make=make, prepare=prepare)
    index = index_video(path, parser)
    assert index.notes == ("frames have an alpha channel: transparent parts are black",)
    with VideoReader(path, index) as reader:
        for frame in (5, 11, 2, 3):
            picture = reader.read(frame).astype(int)
            assert np.abs(picture[:15]).max() <= 3
            assert np.abs(picture[18:] - numbered_picture(frame)[18:]).mean() < 6


SIDE = 128


def moving_square(times: np.ndarray) -> np.ndarray:
    """A picture (128, 128, 3) of a square, whose rows are at the positions of the ``times``."""
    columns = np.arange(SIDE) - 8 - 6 * times[:, None]
    rows = np.abs(np.arange(SIDE) - SIDE // 2) < 32
    grey = np.where((columns >= 0) & (columns < 32) & rows[:, None], 220, 30)
    return np.ascontiguousarray(np.stack([grey] * 3, axis=2), np.uint8)


def interlaced_picture(number: int) -> np.ndarray:
    """A picture whose even rows are half a frame later than its odd rows. The encoder marks the odd rows as the first
    field."""
    return moving_square(number + 0.5 * (np.arange(SIDE) % 2 == 0))


def progressive_picture(number: int) -> np.ndarray:
    return moving_square(np.full(SIDE, float(number)))


def mark_interlaced(stream: Any) -> None:
    parameters = stream.options["x264-params"]
    stream.options = stream.options | {"x264-params": f"{parameters}:interlaced=1:tff=1", "crf": "5"}


@pytest.mark.parametrize("container", ["mp4", "ts"])
def test_interlaced_frames_are_deinterlaced(container: str, tmp_path: Path, parser: ParserProcess) -> None:
    """Catches combs in moving parts of interlaced frames, and frames that depend on the order of reading."""
    path = write(tmp_path / f"a.{container}", "h264", NUMBERS, prepare=mark_interlaced, make=interlaced_picture)
    index = index_video(path, parser)
    assert index.is_interlaced
    with VideoReader(path, index) as reader:
        in_order = [reader.read(frame) for frame in NUMBERS]
        for frame in (7, 11, 0, 6, 3, 2):
            assert np.array_equal(reader.read(frame), in_order[frame])
    for frame in (1, 5, 11):
        truth = progressive_picture(frame)
        assert np.abs(in_order[frame][40:88].astype(int) - truth[40:88]).mean() < 4


def test_progressive_frames_with_a_mark_are_kept(tmp_path: Path, parser: ParserProcess) -> None:
    """Catches progressive frames that lose detail because a camera marks them as interlaced."""
    path = write(tmp_path / "a.ts", "h264", NUMBERS, prepare=mark_interlaced, make=progressive_picture)
    index = index_video(path, parser)
    assert not index.is_interlaced
    assert len(index.notes) == 1
    assert index.notes[0].startswith("marked as interlaced, but moving parts of its frames show one time each")
    with VideoReader(path, index) as reader:
        assert np.abs(reader.read(5).astype(int) - progressive_picture(5)).mean() < 3


def test_still_interlaced_frames_count_as_interlaced() -> None:
    """Catches a decision for progressive video without any motion to judge from, or because plain parts, which show no
    combs, move more often than others."""
    counter = CombCounter()
    counter.marked = 5
    assert counter.is_interlaced
    counter.moving, counter.combed = 1000, 2
    assert not counter.is_interlaced
    counter.combed = 60
    assert counter.is_interlaced


def test_frames_of_another_size_are_refused(tmp_path: Path, parser: ParserProcess) -> None:
    """Catches frames that change their size within a video and end in an error far from the reader."""
    parts = []
    for size, first in ((64, 0), (96, 12)):
        part = write(
            tmp_path / f"{size}.ts",
            "h264",
            range(12),
            Coding(b_frames=0),
            times=[first + number for number in range(12)],
            make=lambda number, size=size: np.full((size, size, 3), 10 * number, np.uint8),
        )
        parts.append(part.read_bytes())
    path = tmp_path / "a.ts"
    path.write_bytes(b"".join(parts))
    with pytest.raises(UserError, match=r"expected frames of 64 x 64 pixels like frame 0, got 96 x 96 in frame 12; "):
        index_video(path, parser)
