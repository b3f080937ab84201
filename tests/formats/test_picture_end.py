"""JPEG and PNG files without their ends are found; whole files with unusual content are not refused."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from fourd.base.errors import UserError
from fourd.base.formats.picture_end import has_end
from fourd.recording.capture.decoding import decode_rgb_bytes


def encoded(kind: str, **options: object) -> bytes:
    pixels = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, **options)  # type: ignore[arg-type]
    return stream.getvalue()


KINDS = (encoded("JPEG"), encoded("JPEG", progressive=True), encoded("PNG"))


@pytest.mark.parametrize("content", KINDS, ids=["baseline", "progressive", "PNG"])
@pytest.mark.parametrize("missing", [1, 3, 10, 100, 1000])
def test_files_without_their_end_are_refused(content: bytes, missing: int) -> None:
    """Catches truncated files, and files whose last bytes are zeros, which decoders read as grey pixels."""
    decode_rgb_bytes(content, "whole")
    for damaged in (content[:-missing], content[:-missing] + bytes(missing)):
        with pytest.raises(UserError, match="one: expected a complete JPEG"):
            decode_rgb_bytes(damaged, "one")


def test_the_end_of_a_preview_is_not_the_end_of_the_file() -> None:
    """Catches a search that finds the end marker of the preview image in the header."""
    preview = b"\xff\xe1" + (2 + len(KINDS[0])).to_bytes(2, "big") + KINDS[0]
    with_preview = KINDS[0][:2] + preview + KINDS[0][2:]
    assert has_end(with_preview)
    assert not has_end(with_preview[:-2])


@pytest.mark.parametrize("content", KINDS, ids=["baseline", "progressive", "PNG"])
def test_bytes_after_the_end_are_allowed(content: bytes) -> None:
    """Catches the refusal of files to which a camera appends its own data."""
    decode_rgb_bytes(content + bytes(5000), "one")
