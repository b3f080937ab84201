"""Frames of a video by number, and videos that are refused."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import av
import numpy as np
import pytest

from fourd.capture.layout import find_videos
from fourd.capture.matroska import SEGMENT, missing_bytes
from fourd.capture.video import VideoReader, index_video
from fourd.capture.video_index import index_capture
from fourd.capture.video_list import KEPT, NAME, Video, aligned, common_frames, list_videos, write_video_list
from fourd.errors import UserError
from fourd.progress import untracked
from tests.capture.films import KEYFRAMES_EVERY, number_of, write_film

KINDS = [("film.mp4", "libx264"), ("film.webm", "libvpx-vp9")]
MATRIX = 40
"""Bytes from the end of the word tkhd to the matrix that turns the picture (ISO 14496-12, version 0)."""


def sequential(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


@pytest.mark.parametrize(("name", "codec"), KINDS)
def test_frames_by_number_are_those_of_sequential_decoding(
    name: str, codec: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Catches a seek that lands after the wanted frame, and B-frames counted in the file's order."""
    path = write_film(tmp_path / name, codec=codec)
    truth = sequential(path)
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


def test_the_test_film_has_b_frames_and_keyframes(tmp_path: Path) -> None:
    """Catches a film that became too simple to catch anything."""
    path = write_film(tmp_path / "film.mp4")
    with av.open(str(path)) as container:
        times = [packet.pts for packet in container.demux(video=0) if packet.pts is not None]
    assert times != sorted(times)
    assert index_video(path).keyframes == tuple(range(0, 40, KEYFRAMES_EVERY))


def test_a_reader_reads_on_after_it_was_closed(tmp_path: Path) -> None:
    """Catches a closed container that is decoded from, and numbers past the end that are clamped."""
    path = write_film(tmp_path / "film.mp4")
    reader = VideoReader(path, index_video(path))
    assert number_of(reader.read(12)) == 12
    reader.close()
    assert number_of(reader.read(13)) == 13
    reader.close()
    with pytest.raises(ValueError, match="expected 0 to 39, got 40"):
        reader.read(40)


def test_another_process_reads_on_its_own(tmp_path: Path) -> None:
    """Catches an open container that is sent along, which no process can take."""
    path = write_film(tmp_path / "film.mp4")
    reader = VideoReader(path, index_video(path))
    reader.read(12)
    sent: VideoReader = pickle.loads(pickle.dumps(reader))
    assert number_of(sent.read(13)) == number_of(reader.read(13)) == 13


def test_a_search_begins_at_the_keyframe_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches right frames at the price of decoding the video from its start, or of a search for each next frame."""
    path = write_film(tmp_path / "film.mp4")
    searches = []
    seek = VideoReader._seek
    monkeypatch.setattr(VideoReader, "_seek", lambda reader, frame: (searches.append(frame), seek(reader, frame))[1])
    with VideoReader(path, index_video(path)) as reader:
        searches.clear()
        for frame in (39, 25, 26, 27, 12, 3):
            assert number_of(reader.read(frame)) == frame
    assert searches == [30, 20, 10, 0]


def refused(path: Path, message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        index_video(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_what_is_no_video_is_refused(tmp_path: Path) -> None:
    """Catches FFmpeg's exceptions on their way to the user."""
    text = tmp_path / "notes.mp4"
    text.write_text("not a video at all")
    refused(text, r"expected a whole video, got '.+'; copy it again")
    refused(tmp_path / "gone.mp4", "got no such file")
    (tmp_path / "empty.mp4").write_bytes(b"")
    refused(tmp_path / "empty.mp4", "expected a whole video")


def test_a_video_cut_short_is_refused(tmp_path: Path) -> None:
    """Catches an interrupted copy: without its index, and with one that promises more frames than there are."""
    whole = write_film(tmp_path / "whole.mp4")
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    refused(cut, "expected a whole video")
    front = write_film(tmp_path / "front.mp4", front=True)
    cut.write_bytes(front.read_bytes()[: front.stat().st_size * 3 // 4])
    refused(cut, r"expected 40 frames, got \d+ before its end; copy or record it again")


@pytest.mark.parametrize(("name", "codec"), [("film.webm", "libvpx-vp9"), ("film.mkv", "libx264")])
def test_a_matroska_file_cut_short_is_refused(name: str, codec: str, tmp_path: Path) -> None:
    """Catches a WebM without a frame count whose end is missing, taken for a shorter one; and a whole one refused."""
    path = write_film(tmp_path / name, codec=codec)
    whole = path.read_bytes()
    assert index_video(path).frames == 40
    for share in (0.6, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        refused(
            path, rf"expected {len(whole)} bytes, as it says, got {int(share * len(whole))}; copy or record it again"
        )
    path.write_bytes(whole + b"\0")
    assert missing_bytes(path) == 0


def test_a_matroska_file_without_a_length_is_no_shorter_for_it(tmp_path: Path) -> None:
    """Catches a live recording refused: its length was not known when its head was written."""
    path = write_film(tmp_path / "film.webm", codec="libvpx-vp9")
    content = bytearray(path.read_bytes())
    place = content.index(SEGMENT) + len(SEGMENT)
    assert content[place] == 1, "a size of eight bytes"
    content[place : place + 8] = b"\x01" + b"\xff" * 7
    path.write_bytes(content)
    assert index_video(path).frames == 40
    for length in range(60):
        path.write_bytes(content[:length])
        assert missing_bytes(path) == 0


def test_a_dropped_frame_is_refused(tmp_path: Path) -> None:
    """Catches cameras that drift apart by a frame from where one dropped one."""
    times = [*range(20), *range(21, 41)]
    refused(write_film(tmp_path / "film.mp4", times=times), r"even rate, got steps of 33.3 to 66.7 ms.*-fps_mode cfr")


def test_times_that_a_container_rounds_are_even(tmp_path: Path) -> None:
    """Catches milliseconds of WebM (33, 34, 33 ms) taken for an uneven rate."""
    path = write_film(tmp_path / "film.webm", codec="libvpx-vp9")
    assert index_video(path).fps == 30


def test_a_video_to_be_shown_turned_is_refused(tmp_path: Path) -> None:
    """Catches a phone's film that lies on its side for us and stands upright for everybody else."""
    path = write_film(tmp_path / "film.mp4")
    content = bytearray(path.read_bytes())
    place = content.index(b"tkhd") + 4 + MATRIX
    quarter = [0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30]
    content[place : place + 36] = b"".join(value.to_bytes(4, "big", signed=True) for value in quarter)
    path.write_bytes(content)
    refused(path, r"expected pictures stored upright, got a video to be shown turned by (90|270) degrees.*ffmpeg -i")


def test_twins_are_told(tmp_path: Path) -> None:
    """Catches one of two videos of a name that is silently left out."""
    for name in ("a.mp4", "a.mov"):
        write_film(tmp_path / name, range(2))
    with pytest.raises(UserError, match=r"a.mp4: expected each camera once, got a.mov of the same name; rename one"):
        find_videos(tmp_path)


def listed(capture: Path) -> dict[str, Video]:
    paths = {"a": write_film(capture / "videos" / "a.mp4"), "b": write_film(capture / "videos" / "b.mp4", range(30))}
    write_video_list(capture, {name: Video(path, index_video(path), 0) for name, path in paths.items()})
    return list_videos(capture)


def test_the_list_of_videos_gives_back_what_was_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches an index that is made again at each opening, which reads whole videos, and one that loses a keyframe."""
    before = listed(tmp_path)
    monkeypatch.setattr("fourd.capture.video_list.index_video", lambda path: pytest.fail(f"{path} was indexed again"))
    again = list_videos(tmp_path)
    assert {name: video.index for name, video in again.items()} == {n: video.index for n, video in before.items()}
    assert common_frames(again) == 30


def test_a_video_that_was_replaced_is_indexed_again(tmp_path: Path) -> None:
    """Catches frames looked for where they lay in the video before."""
    listed(tmp_path)
    write_film(tmp_path / "videos" / "b.mp4", range(35))
    assert list_videos(tmp_path)["b"].index.frames == 35
    assert list_videos(tmp_path)["a"].index.frames == 40


def test_a_capture_without_a_list_is_indexed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches whole videos read again by each process that opens a capture which no import wrote."""
    paths = [write_film(tmp_path / "videos" / f"{name}.mp4") for name in "ab"]
    index_capture(tmp_path, ["a"], untracked)
    indexed = []
    monkeypatch.setattr(
        "fourd.capture.video_list.index_video", lambda path: (indexed.append(path), index_video(path))[1]
    )
    index_capture(tmp_path, None, untracked)
    assert indexed == paths[1:]
    assert {name: video.index.frames for name, video in list_videos(tmp_path).items()} == {"a": 40, "b": 40}
    assert indexed == paths[1:]
    write_film(paths[0], range(35))
    index_capture(tmp_path, None, untracked)
    assert list_videos(tmp_path)["a"].index.frames == 35
    assert indexed == [paths[1], paths[0]]
    (tmp_path / KEPT).write_text("{")
    with pytest.raises(UserError, match=r"\.fourd/videos.json: expected .*; delete it"):
        list_videos(tmp_path)


@pytest.mark.parametrize("text", ["{", "[]", '{"version": 1}', '{"version": 1, "cameras": {"a": {"offset": "x"}}}'])
def test_a_damaged_list_is_told(text: str, tmp_path: Path) -> None:
    """Catches a traceback after a hand edit."""
    listed(tmp_path)
    (tmp_path / NAME).write_text(text)
    with pytest.raises(UserError, match=r"videos.json: expected .*; import again"):
        list_videos(tmp_path)


def test_a_newer_list_is_told(tmp_path: Path) -> None:
    """Catches a later format that is read as this one."""
    (tmp_path / NAME).write_text(json.dumps({"version": 2, "cameras": {}}))
    with pytest.raises(UserError, match="expected version 1, got 2"):
        list_videos(tmp_path)


def test_offsets_count_from_the_smallest() -> None:
    """Catches a camera that would begin before its first frame."""
    assert aligned({"a": 0, "b": -7, "c": 3}) == {"a": 7, "b": 0, "c": 10}
