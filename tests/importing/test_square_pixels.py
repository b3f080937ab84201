"""Imports of videos with non-square pixels: the frames and the calibration are stretched together."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.capture import open_capture, write_calibration
from tests.capture.phone_videos import moving_picture, write_display_matrix
from tests.capture.streams.coded_videos import write
from tests.captures import ring_cameras
from tests.importing.test_importer import run_import

NAMES = ("a", "b", "c")
WIDE = Fraction(4, 3)


def shown_cameras() -> list[Camera]:
    return [replace(camera, width=96, height=64) for camera in ring_cameras(3, 96)]


def squeezed(camera: Camera) -> Camera:
    """The camera of the stored frames, 72 x 64 pixels, of which each is 4/3 as wide as high."""
    return replace(camera, intrinsics=np.diag([0.75, 1, 1]) @ camera.intrinsics, width=72)


def write_source(folder: Path, cameras: list[Camera], *, turned: bool = False) -> Path:
    def prepare(stream: Any) -> None:
        stream.codec_context.sample_aspect_ratio = WIDE

    write_calibration(folder, NAMES, cameras)
    for name in NAMES:
        path = folder / "videos" / f"{name}.mp4"
        picture = moving_picture(0, 72, 64)
        write(path, "h264", range(4), prepare=prepare, make=lambda _, picture=picture: picture)
        if turned:
            write_display_matrix(path, (0, 1, -1, 0))
    return folder


def intrinsics(out: Path) -> list[np.ndarray]:
    return [camera.intrinsics for camera in open_capture(out).distorted_cameras]


def test_calibrations_of_stored_pixels_are_stretched(tmp_path: Path) -> None:
    """Catches a calibration of stored pixels that is used for stretched frames, without a word."""
    source = write_source(tmp_path / "source", [squeezed(camera) for camera in shown_cameras()])
    lines = run_import(source, tmp_path / "out")
    stored = "stored as 72 x 64 with pixels of the aspect ratio 4:3, stretched to 96 x 64"
    assert f"a, b, c: {stored}" in lines
    text = "the calibration belongs to the stored pixels (its images are 72 x 64), so it is stretched too"
    assert f"a, b, c: {text}" in lines
    capture = open_capture(tmp_path / "out")
    assert [(camera.width, camera.height) for camera in capture.cameras] == [(96, 64)] * 3
    assert capture.image(1, 2).shape == (64, 96, 3)
    for ours, theirs in zip(capture.distorted_cameras, shown_cameras(), strict=True):
        assert np.allclose(ours.intrinsics, theirs.intrinsics, rtol=1e-6)


def test_calibrations_of_square_pixels_are_kept(tmp_path: Path) -> None:
    """Catches a calibration of the shown frames that is stretched a second time."""
    source = write_source(tmp_path / "source", shown_cameras())
    lines = run_import(source, tmp_path / "out")
    text = "the calibration belongs to square pixels (its images are 96 x 64), so it is not stretched"
    assert f"a, b, c: {text}" in lines
    for ours, theirs in zip(intrinsics(tmp_path / "out"), shown_cameras(), strict=True):
        assert np.allclose(ours, theirs.intrinsics, rtol=1e-6)


def test_calibrations_without_a_size_are_recognised_by_their_lens(tmp_path: Path) -> None:
    """Catches a calibration of stored pixels that gets the size of the shown frames because it states no size."""
    source = write_source(tmp_path / "source", [squeezed(camera) for camera in shown_cameras()])
    path = source / "intri.yml"
    lines = [line for line in path.read_text().splitlines() if not line.startswith(("H_", "W_"))]
    path.write_text("\n".join(lines) + "\n")
    notes = run_import(source, tmp_path / "out")
    assert any("belongs to the stored pixels (its focal lengths are" in line for line in notes)
    for ours, theirs in zip(intrinsics(tmp_path / "out"), shown_cameras(), strict=True):
        assert np.allclose(ours, theirs.intrinsics, rtol=1e-6)


@pytest.mark.parametrize("reduce", [1.0, 0.5])
def test_stretched_frames_are_turned_and_scaled(reduce: float, tmp_path: Path) -> None:
    """Catches frames that are turned before they are stretched, and a calibration that is not scaled like them."""
    source = write_source(tmp_path / "source", [squeezed(camera) for camera in shown_cameras()], turned=True)
    run_import(source, tmp_path / "out", reduce=reduce, calibrated_frames="stored")
    capture = open_capture(tmp_path / "out")
    size = (round(64 * reduce), round(96 * reduce))
    assert [(camera.width, camera.height) for camera in capture.cameras] == [size] * 3
    assert capture.image(0, 0).shape == (size[1], size[0], 3)
    for ours, theirs in zip(intrinsics(tmp_path / "out"), shown_cameras(), strict=True):
        assert ours[0, 0] == pytest.approx(reduce * theirs.intrinsics[1, 1])
        assert ours[1, 1] == pytest.approx(reduce * theirs.intrinsics[0, 0])


def test_captures_with_such_videos_must_be_imported(tmp_path: Path) -> None:
    """Catches a calibration of stored pixels in a capture that is opened without an import."""
    source = write_source(tmp_path / "a source", [squeezed(camera) for camera in shown_cameras()])
    with pytest.raises(
        UserError, match=r"a.mp4: expected square pixels.* got .* 4:3; .*: fourd import '.*/a source' OUT"
    ):
        open_capture(source)
