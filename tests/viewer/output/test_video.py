"""Writing of videos that players can open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.viewer.output.video import is_video, write_video


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


def decode(path: Path) -> tuple[str, list[np.ndarray], list[float]]:
    """The container, the images and their times in seconds."""
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
        return container.format.name, [frame.to_ndarray(format="rgb24") for frame in frames], [f.time for f in frames]


@pytest.mark.parametrize(
    ("name", "container", "fps"),
    [
        ("a.mp4", "mp4", 24.0),
        ("a.MP4", "mp4", 29.97),
        ("a.webm", "webm", 24.0),
        ("a.WebM", "webm", 29.97),
        ("a.gif", "gif", 24.0),
        ("a.GIF", "gif", 30.0),
        ("b.gif", "gif", 50.0),
    ],
)
def test_the_suffix_determines_the_format(name: str, container: str, fps: float, tmp_path: Path) -> None:
    """Catches a suffix in capitals that is not a video, a file in another format than its name says, a video with
    another number of images or rate, and GIF images that are stored as a difference to an image with other colours.
    """
    assert write_video(tmp_path / name, make_images(13, 51, 65), fps) == 13
    found, images, times = decode(tmp_path / name)
    assert container in found
    assert len(images) == 13
    # Times are whole hundredths of a second in GIF files, and whole thousandths in WebM files.
    assert np.abs(np.array(times) - np.arange(13) / fps).max() < 0.006
    for index, image in enumerate(images):
        assert np.abs(image[25, 10].astype(int) - (200, 40, 30)).max() < 12, index
        assert np.argmax(image[25, 50]) == index % 3, index
    assert list(tmp_path.iterdir()) == [tmp_path / name]


@pytest.mark.parametrize("suffix", [".gif", ".webm"])
def test_videos_look_like_the_images(suffix: str, tmp_path: Path) -> None:
    """Catches swapped channels, a palette of another image, and a quality that is far too low."""
    rows, columns = np.mgrid[:64, :96] / 64
    images = [
        np.stack([(rows + shift) % 1, columns / 1.5, np.sin(4 * rows + shift) ** 2], axis=2).astype(np.float32)
        for shift in (0.0, 0.2, 0.4)
    ]
    write_video(tmp_path / f"a{suffix}", iter(images), 10)
    for image, decoded in zip(images, decode(tmp_path / f"a{suffix}")[1], strict=True):
        assert np.sqrt(np.square(image - decoded / 255).mean()) < 0.06


def test_other_names_are_refused_before_anything_is_rendered(tmp_path: Path) -> None:
    """Catches a folder named like a video, and a file whose format is not what its name says."""
    for name in ("a.avi", "a.mov", "a.png", "out.v2"):
        with pytest.raises(UserError, match=r"a folder, or a video that ends in \.mp4, \.webm, \.gif, got the suffix"):
            is_video(tmp_path / name)
        with pytest.raises(UserError, match=r"expected a video that ends in \.mp4, \.webm, \.gif"):
            write_video(tmp_path / name, make_images(1, 8, 8), 24)
    (tmp_path / "out.v2").mkdir()
    (tmp_path / "old.gif").mkdir()
    (tmp_path / "file").write_text("")
    assert not is_video(tmp_path / "out.v2"), "the user's own folder"
    assert not is_video(tmp_path / "new")
    assert not is_video(Path("."))
    assert is_video(tmp_path / "a.WEBM")
    with pytest.raises(UserError, match="expected a video file, got a folder of this name"):
        is_video(tmp_path / "old.gif")
    with pytest.raises(UserError, match="expected a folder, got a file of this name"):
        is_video(tmp_path / "file")
    with pytest.raises(UserError, match="expected at most 50 images per second for a GIF, got 60; add --fps 50"):
        write_video(tmp_path / "a.gif", make_images(1, 8, 8), 60)
