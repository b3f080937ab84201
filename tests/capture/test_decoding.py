"""Decoding of image files. Only a few formats are decoded, regardless of the file's suffix."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import EpsImagePlugin, Image

from fourd.base.errors import UserError
from fourd.recording.capture.check import check_capture
from fourd.recording.capture.decoding import decode_alpha, decode_matte, decode_rgb, decode_rgb_bytes, picture_size
from tests.captures import write_ball_capture

DECODERS = (decode_rgb, decode_matte, decode_alpha, picture_size, lambda path: decode_rgb_bytes(path.read_bytes(), "x"))


@pytest.fixture
def no_ghostscript(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object, **options: object) -> None:
        pytest.fail("a picture file started Ghostscript")

    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", fail)


def encode(file_format: str) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.full((64, 64, 3), 90, np.uint8)).save(stream, file_format)
    return stream.getvalue()


@pytest.mark.usefixtures("no_ghostscript")
@pytest.mark.parametrize("decode", DECODERS)
@pytest.mark.parametrize("file_format", ["EPS", "GIF", "PPM"])
def test_other_formats_are_refused(tmp_path: Path, decode: Callable[[Path], object], file_format: str) -> None:
    """Catches a decoder that is chosen by content and runs the PostScript code of an EPS file named .jpg."""
    path = tmp_path / "000000.jpg"
    path.write_bytes(encode(file_format))
    with pytest.raises(UserError, match=r"expected a complete JPEG, PNG, .* image, got another format; copy"):
        decode(path)


@pytest.mark.usefixtures("no_ghostscript")
def test_check_refuses_eps_in_images_and_masks(tmp_path: Path) -> None:
    """Catches code that opens an image of a capture without the functions of the decoding module."""
    capture = write_ball_capture(tmp_path, cameras=3)
    (capture / "images" / "01" / "000001.png").write_bytes(encode("EPS"))
    (capture / "masks" / "02" / "000001.png").write_bytes(encode("EPS"))
    problems = check_capture(capture, deep=True).problems
    assert len(problems) == 2
    assert all("TIFF or WebP image, got another format" in problem for problem in problems)


def test_alpha_is_read_and_opaque_without_a_channel(tmp_path: Path) -> None:
    """Catches holes of a plate that are lost, and images without alpha that count as holes."""
    path = tmp_path / "plate.png"
    rgba = np.full((4, 5, 4), 200, np.uint8)
    rgba[1, 2, 3] = 0
    Image.fromarray(rgba).save(path)
    assert np.array_equal(decode_alpha(path), rgba[..., 3])
    Image.fromarray(rgba[..., :3]).save(path)
    assert (decode_alpha(path) == 255).all()
