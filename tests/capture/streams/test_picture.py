"""Tone mapping of HDR frames."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.recording.capture.streams.picture import to_rgb
from tests.capture.phone_videos import make_frame, moving_picture


@pytest.mark.parametrize("transfer", ["HLG", "PQ"])
def test_hdr_frames_show_the_colours_of_the_scene(transfer: str) -> None:
    """Catches a wrong transfer function, colour matrix or value range. The test uses no encoder, so the conversion to
    HDR and back must hardly change the picture.
    """
    picture = moving_picture(0.3)
    shown = to_rgb(make_frame(picture, transfer), 0, transfer, (64, 48))
    assert -10 * np.log10(np.square(shown.astype(np.float64) - picture).mean() / 255**2) > 36


@pytest.mark.parametrize("transfer", ["HLG", "PQ"])
def test_highlights_keep_their_order_and_hue(transfer: str) -> None:
    """Catches highlights brighter than white that are clipped to one value, or whose hue changes."""
    levels = np.linspace(0.8, 4.0, 8)
    linear = np.repeat(levels, 8)[None, :, None] * np.ones((32, 1, 1)) * np.array([1.0, 1.0, 1.0])
    encoded = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    shown = to_rgb(make_frame(encoded, transfer), 0, transfer, (64, 32))[16, 4::8].astype(int)
    assert np.abs(shown - shown[:, :1]).max() <= 2
    assert shown[1, 1] < 252  # 1.26 times white
    assert (np.diff(shown[:, 1]) >= 0).all()
    assert 230 < shown[0, 1] < 233
    assert 252 <= shown[-1, 1] <= 255
