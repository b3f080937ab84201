"""Writing of MP4 files that players can open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest

from fourd.errors import UserError
from fourd.viewer.output.video import write_video


def make_images(count: int, height: int, width: int) -> Iterator[np.ndarray]:
    for index in range(count):
        image = np.zeros((height, width, 3), np.uint8)
        image[:, : width // 2] = (200, 40, 30)
        image[:, width // 2 :, index % 3] = 180
        yield image


def test_videos_decode_to_the_written_images(tmp_path: Path) -> None:
    """Catches videos with swapped channels, wrong colours or a wrong rate, and an error for odd image sizes."""
    path = tmp_path / "a.mp4"
    assert write_video(path, make_images(7, 51, 65), 24) == 7
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert float(stream.average_rate) == pytest.approx(24)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 7
    assert frames[0].shape == (52, 66, 3)
    assert np.abs(frames[3][25, 10].astype(int) - (200, 40, 30)).max() < 12
    assert list(tmp_path.iterdir()) == [path]


def test_invalid_images_leave_no_file(tmp_path: Path) -> None:
    """Catches an empty video file that no player can open."""
    with pytest.raises(UserError, match="expected at least one image"):
        write_video(tmp_path / "a.mp4", iter(()), 24)
    mixed = [np.zeros((8, 8, 3), np.uint8), np.zeros((8, 10, 3), np.uint8)]
    with pytest.raises(ValueError, match="like the first"):
        write_video(tmp_path / "a.mp4", mixed, 24)
    assert list(tmp_path.iterdir()) == []
