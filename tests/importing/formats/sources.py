"""Helpers for the tests of the importers: asymmetric cameras, small images and videos, and checks of error messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.importing.detection import FORMATS
from fourd.recording.importing.imported import Imported, PictureFiles, VideoFile
from tests.captures import ring_cameras

WIDTH, HEIGHT = 24, 16
BARREL = np.array([-0.25, 0.06, 0.002, -0.001, 0.01])

Read = Callable[[Path], Imported]


def uneven_cameras(count: int, distortion: np.ndarray | None = None) -> list[Camera]:
    """Cameras in a ring. All intrinsic parameters have different values, so that tests detect swapped parameters."""
    cameras = []
    for index, camera in enumerate(ring_cameras(count, WIDTH)):
        intrinsics = np.array([[26.0 + index, 0, 11.3], [0, 27.5, 8.9 - 0.1 * index], [0, 0, 1]])
        cameras.append(replace(camera, intrinsics=intrinsics, height=HEIGHT, distortion=distortion))
    return cameras


def assert_same_view(lens: Camera | None, original: Camera, rng: np.random.Generator) -> None:
    """Assert that two cameras project random world points in metres to the same pixels, including lens distortion."""
    assert lens is not None
    assert (lens.width, lens.height) == (original.width, original.height)
    xyz = rng.uniform(-0.4, 0.4, (50, 3))
    seen = []
    for camera in (lens, original):
        rotation = cv2.Rodrigues(camera.rotation)[0]
        distortion = np.zeros(5) if camera.distortion is None else camera.distortion
        seen.append(cv2.projectPoints(xyz, rotation, camera.translation, camera.intrinsics, distortion)[0])
    assert np.abs(seen[0] - seen[1]).max() < 1e-6


def picture_bytes(suffix: str = ".jpg", grey: int = 90) -> bytes:
    """A small encoded image."""
    done, content = cv2.imencode(suffix, np.full((HEIGHT, WIDTH, 3), grey, np.uint8))
    assert done
    return content.tobytes()


def write_pictures(folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(picture_bytes(Path(name).suffix))


def write_video(path: Path, frames: int = 2) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for number in range(frames):
            picture = np.full((HEIGHT, WIDTH, 3), 40 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def file_names(frames: object) -> list[str]:
    """Names of the files that store a camera's frames or mattes, in the order of the frames."""
    if isinstance(frames, VideoFile):
        return [frames.path.name]
    assert isinstance(frames, PictureFiles)
    assert all(path.is_file() for path in frames.paths)
    return [path.name for path in frames.paths]


def detect_format(source: Path) -> str | None:
    """The name of the first format that recognises ``source``."""
    return next((form.name for form in FORMATS if form.looks_like(source)), None)


def assert_refused(read: Read, source: Path, message: str) -> None:
    """Assert that reading raises a one-line UserError that matches ``message`` and names a fix."""
    with pytest.raises(UserError, match=message) as caught:
        read(source)
    assert "\n" not in str(caught.value)
    assert "; " in str(caught.value), "the fix is missing"


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def assert_damage_is_reported(
    read: Read, source: Path, file: Path, rng: np.random.Generator, flips: bool = True
) -> None:
    """Assert that reading a truncated or corrupted file either succeeds or raises a one-line UserError."""
    whole = file.read_bytes()
    for attempt in range(24):
        damaged = bytearray(whole[: rng.integers(len(whole))] if attempt % 2 else whole)
        if flips:
            for position in rng.integers(0, max(len(damaged), 1), 3):
                damaged[position : position + 1] = rng.bytes(1)
        file.write_bytes(damaged)
        message = ""
        try:
            read(source)
        except UserError as error:
            message = str(error)
        assert "\n" not in message
    file.write_bytes(whole)
