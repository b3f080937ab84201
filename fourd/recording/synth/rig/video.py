"""Compressed videos: H.264 or HEVC in an MP4 file, at a constant quality or at a given bit rate."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.recording.synth.rig.settings import Codec, RigSettings

ENCODERS = {"h264": "libx264", "hevc": "libx265"}


def check_video(codec: Codec, width: int, height: int) -> None:
    """Raise UserError if images of this size cannot be encoded on this machine."""
    if ENCODERS[codec] not in av.codecs_available:
        raise UserError(
            f"--codec: expected an encoder for {codec} in the package av, got none; use the other codec or video=0"
        )
    if width % 2 or height % 2:
        raise UserError(
            f"--rig: video: expected images with an even width and height, got {width} x {height}; "
            "resize the images, or write video=0"
        )


def write_video(
    path: Path, pictures: Iterable[NDArray[np.uint8]], size: tuple[int, int], rate: Fraction, settings: RigSettings
) -> None:
    """Encode RGB pictures of ``size`` (width, height).

    One thread encodes, because encoders with several threads may give other bytes on machines with other numbers of
    cores.
    """
    options = {"threads": "1", "preset": "medium"}
    if settings.codec == "hevc":
        options["x265-params"] = "log-level=error:pools=none:frame-threads=1"
    if settings.mbps is None:
        options["crf"] = f"{settings.video:g}"
    with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream(ENCODERS[settings.codec], rate=rate, options=options)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        if settings.codec == "hevc":
            stream.codec_tag = "hvc1"  # the tag that players of Apple expect
        if settings.mbps is not None:
            stream.bit_rate = round(settings.mbps * 1e6)
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
