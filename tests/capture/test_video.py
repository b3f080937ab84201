"""Random access to video frames, and videos that are refused."""

from __future__ import annotations

import json
import pickle
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.progress import untracked
from fourd.recording.capture.layout import find_videos
from fourd.recording.capture.streams.frames import FrameReader
from fourd.recording.capture.streams.matroska import HEADER, SEGMENT, missing_bytes
from fourd.recording.capture.video import VideoReader, index_video
from fourd.recording.capture.video_index import index_capture
from fourd.recording.capture.video_list import (
    CACHE,
    NAME,
    Video,
    align_offsets,
    common_frames,
    list_videos,
    write_video_list,
)
from tests.capture.numbered_videos import KEYFRAME_INTERVAL, number_of, write_numbered_video
from tests.capture.phone_videos import write_display_matrix

KINDS = [("video.mp4", "libx264"), ("video.webm", "libvpx-vp9")]


def decode_sequentially(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


@pytest.mark.parametrize(("name", "codec"), KINDS)
def test_random_access_equals_sequential_decoding(
    name: str, codec: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Catches a seek to a position after the requested frame, and B-frames that are counted in the file's order."""
    path = write_numbered_video(tmp_path / name, codec=codec)
    truth = decode_sequentially(path)
    index = index_video(path)
    assert (index.width, index.height, index.frames, index.fps) == (32, 48, 40, 30)
    assert len(index.keyframes) >= 3
    assert index.keyframes[0] == 0
    order = [39, 0, 20, 19, 21, 9, 10, 11, *rng.permutation(40).tolist(), 5, 5]
    with VideoReader(path, index) as reader:
        for frame in order:
            picture = reader.read(frame)
            assert number_of(picture) == frame
            assert np.array_equal(picture, truth[frame])
            assert not picture.flags.writeable


def test_test_video_has_b_frames_and_keyframes(tmp_path: Path) -> None:
    """Catches a test video without B-frames or with too few keyframes. With such a video, the other tests would find no
    errors.
    """
    path = write_numbered_video(tmp_path / "video.mp4")
    with av.open(str(path)) as container:
        times = [packet.pts for packet in container.demux(video=0) if packet.pts is not None]
    assert times != sorted(times)
    assert index_video(path).keyframes == tuple(range(0, 40, KEYFRAME_INTERVAL))


def test_reader_reopens_after_close(tmp_path: Path) -> None:
    """Catches decoding from a closed video, and frame numbers past the end that are clamped."""
    path = write_numbered_video(tmp_path / "video.mp4")
    reader = VideoReader(path, index_video(path))
    assert number_of(reader.read(12)) == 12
    reader.close()
    assert number_of(reader.read(13)) == 13
    reader.close()
    with pytest.raises(ValueError, match="expected 0 to 39, got 40"):
        reader.read(40)


def test_reader_can_be_pickled(tmp_path: Path) -> None:
    """Catches a reader that is pickled together with its open video."""
    path = write_numbered_video(tmp_path / "video.mp4")
    reader = VideoReader(path, index_video(path))
    reader.read(12)
    sent: VideoReader = pickle.loads(pickle.dumps(reader))
    assert number_of(sent.read(13)) == number_of(reader.read(13)) == 13


def test_seek_starts_at_the_keyframe_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches decoding from the start of the video, and a seek before each consecutive frame."""
    path = write_numbered_video(tmp_path / "video.mp4")
    seeks = []
    enter = FrameReader._enter
    monkeypatch.setattr(FrameReader, "_enter", lambda reader, frame: (seeks.append(frame), enter(reader, frame))[1])
    with VideoReader(path, index_video(path)) as reader:
        seeks.clear()
        for frame in (39, 25, 26, 27, 12, 3):
            assert number_of(reader.read(frame)) == frame
    assert seeks == [30, 20, 10, 0]


def assert_refused(path: Path, message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        index_video(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_other_files_are_refused(tmp_path: Path) -> None:
    """Catches exceptions of FFmpeg that reach the user."""
    text = tmp_path / "notes.mp4"
    text.write_text("not a video at all")
    assert_refused(text, r"expected a complete video, got '.+'; copy the file again")
    assert_refused(tmp_path / "gone.mp4", "got no such file")
    (tmp_path / "empty.mp4").write_bytes(b"")
    assert_refused(tmp_path / "empty.mp4", "expected a complete video")


def test_truncated_mp4_is_refused(tmp_path: Path) -> None:
    """Catches an interrupted copy that is accepted although its index is missing or declares more frames than the file
    contains."""
    whole = write_numbered_video(tmp_path / "whole.mp4")
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert_refused(cut, "expected a complete video")
    front = write_numbered_video(tmp_path / "front.mp4", index_first=True)
    cut.write_bytes(front.read_bytes()[: front.stat().st_size * 3 // 4])
    assert_refused(cut, r"expected 40 frames, got \d+; copy or record the video again")


@pytest.mark.parametrize(("name", "codec"), [("video.webm", "libvpx-vp9"), ("video.mkv", "libx264")])
def test_truncated_matroska_is_refused(name: str, codec: str, tmp_path: Path) -> None:
    """Catches a truncated WebM that is accepted because the file stores no frame count, and a complete WebM that is
    refused."""
    path = write_numbered_video(tmp_path / name, codec=codec)
    whole = path.read_bytes()
    assert index_video(path).frames == 40
    for share in (0.6, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        got = int(share * len(whole))
        assert_refused(path, rf"expected {len(whole)} bytes according to the file's header, got {got}; copy or record")
    path.write_bytes(whole + b"\0")
    assert missing_bytes(path) == 0


def test_matroska_without_a_length_is_accepted(tmp_path: Path) -> None:
    """Catches a live recording that is refused because its header has no length."""
    path = write_numbered_video(tmp_path / "video.webm", codec="libvpx-vp9")
    content = bytearray(path.read_bytes())
    offset = content.index(SEGMENT) + len(SEGMENT)
    assert content[offset] == 1, "a size of eight bytes"
    content[offset : offset + 8] = b"\x01" + b"\xff" * 7
    path.write_bytes(content)
    assert index_video(path).frames == 40
    for length in range(60):
        path.write_bytes(content[:length])
        assert missing_bytes(path) == 0
    path.write_bytes(HEADER + b"\x01" + b"\xfe" * 7)  # no system can seek past the 2^56 bytes of this header
    assert missing_bytes(path) == 0


def test_dropped_frame_keeps_the_times_of_later_frames(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches wrong times or numbers of all frames after a dropped frame."""
    times = [*range(20), *range(21, 41)]
    path = write_numbered_video(tmp_path / "video.mp4", times=times)
    index = index_video(path)
    assert (index.frames, index.fps) == (40, 30)
    assert [index.nearest(Fraction(time, 30)) for time in times] == list(range(40))
    assert index.nearest(Fraction(203, 300)) == 20
    with VideoReader(path, index) as reader:
        for frame in rng.permutation(40).tolist():
            assert number_of(reader.read(frame)) == frame


def test_videos_without_usable_times_are_refused(tmp_path: Path) -> None:
    """Catches a traceback or a wrong frame rate for one frame, and for frames without different times."""
    assert_refused(write_numbered_video(tmp_path / "one.mp4", range(1)), "expected a video of at least 2 frames, got 1")
    path = tmp_path / "raw.h264"
    with av.open(str(write_numbered_video(tmp_path / "video.mp4"))) as source, av.open(str(path), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                packet.stream = stream
                target.mux(packet)
    assert_refused(
        path, r"expected frames at increasing times, 0.1 ms .* got .*; write times of, .* with: ffmpeg -r 30"
    )


def test_rounded_times_are_a_constant_rate(tmp_path: Path) -> None:
    """Catches a constant frame rate that is refused because WebM rounds times to milliseconds (33, 34, 33 ms)."""
    path = write_numbered_video(tmp_path / "video.webm", codec="libvpx-vp9")
    assert index_video(path).fps == 30


@pytest.mark.parametrize("matrix", [(-1, 0, 0, 1), (0, 1, 1, 0), (0.6, 0.8, -0.8, 0.6)])
def test_mirrored_and_oblique_videos_are_refused(matrix: tuple[float, ...], tmp_path: Path) -> None:
    """Catches a display matrix with a mirror or an oblique angle that is read as a rotation by a multiple of 90
    degrees.
    """
    path = write_display_matrix(write_numbered_video(tmp_path / "video.mp4"), matrix)
    assert_refused(path, r"expected frames turned by a multiple of 90 degrees and not mirrored.*ffmpeg -i")


def test_videos_of_one_name_are_refused(tmp_path: Path) -> None:
    """Catches a capture with two videos of the same name that is read without an error."""
    for name in ("a.mp4", "a.mov"):
        write_numbered_video(tmp_path / name, range(2))
    with pytest.raises(
        UserError, match=r"a.mp4: expected one video per camera, got a.mov for the same camera; rename one"
    ):
        find_videos(tmp_path)


def write_listed_videos(capture: Path) -> dict[str, Video]:
    paths = {
        "a": write_numbered_video(capture / "videos" / "a.mp4"),
        "b": write_numbered_video(capture / "videos" / "b.mp4", range(30)),
    }
    write_video_list(capture, {name: Video(path, index_video(path), 0) for name, path in paths.items()})
    return list_videos(capture)


def test_video_list_round_trip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches videos that are indexed again each time they are opened, and a keyframe that is missing in the stored
    index."""
    before = write_listed_videos(tmp_path)
    again = "indexed again"
    monkeypatch.setattr(
        "fourd.recording.capture.video_list.index_video", lambda path, _: pytest.fail(f"{path} was {again}")
    )
    again = list_videos(tmp_path)
    assert {name: video.index for name, video in again.items()} == {n: video.index for n, video in before.items()}
    assert common_frames(again) == 30


def test_replaced_video_is_indexed_again(tmp_path: Path) -> None:
    """Catches a replaced video that is read with the index of the old video."""
    write_listed_videos(tmp_path)
    write_numbered_video(tmp_path / "videos" / "b.mp4", range(35))
    assert list_videos(tmp_path)["b"].index.frames == 35
    assert list_videos(tmp_path)["a"].index.frames == 40


def test_capture_without_a_list_is_indexed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches videos that are indexed again by each process that opens a capture without videos.json."""
    paths = [write_numbered_video(tmp_path / "videos" / f"{name}.mp4") for name in "ab"]
    index_capture(tmp_path, ["a"], untracked)
    indexed = []
    monkeypatch.setattr(
        "fourd.recording.capture.video_list.index_video", lambda path, _: (indexed.append(path), index_video(path))[1]
    )
    index_capture(tmp_path, None, untracked)
    assert indexed == paths[1:]
    assert {name: video.index.frames for name, video in list_videos(tmp_path).items()} == {"a": 40, "b": 40}
    assert indexed == paths[1:]
    write_numbered_video(paths[0], range(35))
    index_capture(tmp_path, None, untracked)
    assert list_videos(tmp_path)["a"].index.frames == 35
    assert indexed == [paths[1], paths[0]]
    (tmp_path / CACHE).write_text("{")
    with pytest.raises(UserError, match=r"\.fourd/videos.json: expected .*; delete the file"):
        list_videos(tmp_path)


@pytest.mark.parametrize("text", ["{", "[]", '{"version": 1}', '{"version": 1, "cameras": {"a": {"offset": "x"}}}'])
def test_damaged_list_is_reported(text: str, tmp_path: Path) -> None:
    """Catches a traceback after a manual edit of videos.json."""
    write_listed_videos(tmp_path)
    (tmp_path / NAME).write_text(text)
    with pytest.raises(UserError, match=r"videos.json: expected .*; import again"):
        list_videos(tmp_path)


def write_old_list(capture: Path, change: dict[str, object]) -> None:
    """Write the list of videos as an older version of fourd did: with other frames, and without the newer fields."""
    write_listed_videos(capture)
    content = json.loads((capture / NAME).read_text()) | {"version": 2}
    for entry in content["cameras"].values():
        known = ("width", "height", "start", "fps", "keyframes", "turn", "transfer", "scale", "tick", "times")
        entry["index"] = {name: entry["index"][name] for name in known} | {"frames": 7} | change
        entry["offset"] = 2.5
    (capture / NAME).write_text(json.dumps(content))


def test_older_lists_are_indexed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches frames of an older list that are named by wrong numbers, offsets of the list that are lost, and videos
    that are indexed again by each process that opens the capture."""
    write_old_list(tmp_path, {"width": 16, "height": 24, "scale": 0.5})
    index_capture(tmp_path, None, untracked)
    monkeypatch.setattr(
        "fourd.recording.capture.video_list.index_video", lambda path, _: pytest.fail(f"{path} is read again")
    )
    videos = list_videos(tmp_path)
    assert {name: (video.index.frames, video.offset) for name, video in videos.items()} == {
        "a": (40, 2.5),
        "b": (30, 2.5),
    }
    assert [(video.index.width, video.index.height) for video in videos.values()] == [(16, 24)] * 2


def test_older_lists_of_other_sizes_are_refused(tmp_path: Path) -> None:
    """Catches a calibration of squeezed frames that is used for the stretched frames of this version."""
    write_old_list(tmp_path, {"width": 24})
    with pytest.raises(UserError, match=r"expected frames of 24 x 48 pixels in a.mp4, got 32 x 48, .*; import again"):
        list_videos(tmp_path)


def test_newer_list_is_refused(tmp_path: Path) -> None:
    """Catches a file of a newer format version that is read as the current version."""
    (tmp_path / NAME).write_text(json.dumps({"version": 4, "cameras": {}}))
    with pytest.raises(UserError, match="expected version 3 or older, got 4"):
        list_videos(tmp_path)


def test_smallest_offset_is_zero() -> None:
    """Catches an offset at which a camera would start before its first frame."""
    assert align_offsets({"a": 0, "b": -7, "c": 3}) == {"a": 7, "b": 0, "c": 10}
