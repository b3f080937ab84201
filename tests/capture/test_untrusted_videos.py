"""Videos from untrusted sources: wrong lists of frames, frame rates of zero, and files that stay open."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.recording.capture import open_capture, write_calibration
from fourd.recording.capture.video import index_video
from fourd.recording.capture.video_list import list_videos
from tests.capture.numbered_videos import write_numbered_video, write_slow_video
from tests.capture.test_video import assert_refused, write_listed_videos
from tests.captures import ring_cameras


def test_closed_captures_keep_no_file_open(tmp_path: Path) -> None:
    """Catches captures that keep a file and threads for each video until the program ends."""
    write_calibration(tmp_path, ["a", "b"], [replace(camera, width=32, height=48) for camera in ring_cameras(2, 32)])
    for name in "ab":
        write_numbered_video(tmp_path / "videos" / f"{name}.mp4")
    before = len(os.listdir("/proc/self/fd"))
    with open_capture(tmp_path) as capture:
        first = capture.image(0, 3)
        assert len(os.listdir("/proc/self/fd")) > before
    assert len(os.listdir("/proc/self/fd")) == before
    assert (capture.image(0, 3) == first).all(), "a closed capture opens its videos again"
    capture.close()


@pytest.mark.parametrize(
    "change",
    [
        {"frames": 10**12},
        {"frames": 1.5},
        {"frames": True},
        {"keyframes": [10**12]},
        {"keyframes": [3, 1]},
        {"times": [3, 2, 1], "frames": 3},
        {"width": 1 << 15, "height": 1 << 15},
        {"fps": "1/1000000"},
        {"scale": float("nan")},
        {"hostile": 1},
    ],
)
def test_invalid_lists_are_refused(tmp_path: Path, change: dict[str, object]) -> None:
    """Catches a list of 10^12 frames that fills the memory, and an invalid index of frames that is accepted."""
    write_listed_videos(tmp_path)
    content = json.loads((tmp_path / "videos.json").read_text())
    content["cameras"]["a"]["index"] |= change
    (tmp_path / "videos.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match=r"videos.json: expected the index of a.mp4, got invalid content"):
        list_videos(tmp_path)


def test_time_lapses_are_read_or_refused(tmp_path: Path) -> None:
    """Catches a division by a frame rate that is rounded to 0."""
    path = tmp_path / "a.mkv"
    for seconds, fps in ((60, Fraction(1, 60)), (3600, None)):
        write_slow_video(path, Fraction(seconds))
        if fps is not None:
            assert index_video(path).fps == fps
        else:
            assert_refused(path, r"expected frames at increasing times, .*, got one frame each 3.6e\+03 s; write times")
