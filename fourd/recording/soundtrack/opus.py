"""Encodes samples as Opus in an Ogg file, and decodes such files. Opus is the codec that browsers, FFmpeg and phones
share without a licence; an Ogg file starts and ends at exact samples."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.soundtrack.ogg import RATE, OggError, inspect_opus

Samples = NDArray[np.float32]
"""Samples (C, N) of C channels relative to full scale, at 48 kHz."""

LAYOUTS = {1: "mono", 2: "stereo"}
BIT_RATES = {1: 80_000, 2: 128_000}
"""Bits per second by number of channels. At these rates, listeners rarely tell Opus from the original."""
ENCODER = "libopus"


def encode_opus(blocks: Iterable[Samples], channels: int) -> bytes:
    """Encode blocks of samples (C, N) as an Ogg file. Values outside [-1, 1] are clipped.

    Raises:
        UserError: if FFmpeg in PyAV has no encoder for Opus.
        ValueError: if there are no samples.
    """
    if ENCODER not in av.codecs_available:
        raise UserError(
            "expected FFmpeg with an encoder for Opus in PyAV, got none; "
            "pip install --force-reinstall --only-binary=:all: av, or leave the sound out with --sound none"
        )
    file, position = io.BytesIO(), 0
    with av.open(file, "w", format="ogg") as container:
        stream: Any = container.add_stream(ENCODER, rate=RATE, layout=LAYOUTS[channels])
        stream.bit_rate = BIT_RATES[channels]
        for block in blocks:
            for frame in _frames(block, channels, position):
                container.mux(stream.encode(frame))
            position += block.shape[1]
        if position == 0:
            raise ValueError("blocks: expected at least one sample, got none")
        container.mux(stream.encode(None))
    return file.getvalue()


def decode_opus(content: bytes) -> Iterator[Samples]:
    """Decode an Ogg file block by block. Raises :class:`~fourd.recording.soundtrack.ogg.OggError` if it is damaged."""
    info, count = inspect_opus(content), 0
    try:
        with av.open(io.BytesIO(content), "r", format="ogg", options={"format_whitelist": "ogg"}) as container:
            for frame in container.decode(container.streams.audio[0]):
                block = np.atleast_2d(frame.to_ndarray().astype(np.float32))[:, : info.samples - count]
                if block.shape[0] != info.channels:
                    raise OggError(f"expected {info.channels} channels, got {block.shape[0]}")
                count += block.shape[1]
                if block.shape[1]:
                    yield block
    except (av.FFmpegError, OSError, IndexError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise OggError(f"expected Opus that can be decoded, got '{reason}'") from error
    if count < info.samples:
        raise OggError(f"expected {info.samples} samples, got {count}")


def cut(blocks: Iterable[Samples], begin: int, count: int, channels: int) -> Iterator[Samples]:
    """Yield ``count`` samples from the sample ``begin`` of a sound on, with silence before its start and after its end.

    ``begin`` can be negative.
    """
    left = count
    if begin < 0:
        before = min(-begin, left)
        yield from silence(before, channels)
        left, begin = left - before, 0
    for block in blocks:
        if left == 0:
            return
        part = block[:, begin : begin + left]
        begin = max(begin - block.shape[1], 0)
        left -= part.shape[1]
        if part.shape[1]:
            yield part
    yield from silence(left, channels)


def silence(count: int, channels: int) -> Iterator[Samples]:
    """Yield ``count`` silent samples in blocks of at most a second."""
    for start in range(0, count, RATE):
        yield np.zeros((channels, min(RATE, count - start)), np.float32)


def _frames(block: Samples, channels: int, position: int) -> Iterator[Any]:
    if block.shape[0] != channels:
        raise ValueError(f"blocks: expected {channels} channels, got {block.shape[0]}")
    limited = np.ascontiguousarray(np.clip(np.nan_to_num(block), -1, 1), np.float32)
    for start in range(0, limited.shape[1], RATE):
        part = np.ascontiguousarray(limited[:, start : start + RATE])
        frame = av.AudioFrame.from_ndarray(part, format="fltp", layout=LAYOUTS[channels])
        frame.sample_rate, frame.pts, frame.time_base = RATE, position + start, Fraction(1, RATE)
        yield frame
