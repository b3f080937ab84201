"""Reads the soundtracks of videos and sound files block by block, on the clock of the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.container import InputContainer

from fourd.base.errors import UserError
from fourd.base.limits import require_regular
from fourd.recording.capture.streams.container import CONTAINERS
from fourd.recording.soundtrack.ogg import RATE
from fourd.recording.soundtrack.opus import LAYOUTS, Samples, cut, encode_opus, silence

SOUND_CONTAINERS = f"{CONTAINERS},wav,aiff,flac,mp3,ogg,aac,caf"
MAX_GAP_SECONDS = 0.005
"""Maximum duration, in seconds, of a gap between two decoded audio frames that is ignored. Longer gaps are filled with
silence."""
CLIPPED = 0.985
"""Level, relative to full scale, from which on a sample counts as clipped. Lossy codecs change clipped samples a
little."""


@dataclass(frozen=True)
class SoundLevel:
    """What is known of a soundtrack, measured over the time of the capture.

    Attributes:
        rate: sampling rate of the file in Hz.
        channels: number of channels that are kept, 1 or 2.
        rms: root mean square of the samples, relative to full scale.
        clipped: share of the samples that are clipped, in [0, 1].
    """

    rate: int
    channels: int
    rms: float
    clipped: float


@dataclass(frozen=True, eq=False)
class SoundBlock:
    """Successive samples (C, N). ``seconds`` is the time of the first sample on the clock of the file."""

    seconds: float
    samples: Samples


def decode_blocks(container: InputContainer, rate: int, layout: str) -> Iterator[SoundBlock]:
    """Decode the first soundtrack of an open file, resampled to ``rate`` Hz and with the channels of ``layout``.

    Gaps of more than 5 ms are filled with silence, in blocks of at most a second.
    """
    resampler = av.AudioResampler(format="fltp", layout=layout, rate=rate)
    channels = resampler.layout.nb_channels if resampler.layout is not None else 1
    start, count = None, 0
    for frame in container.decode(container.streams.audio[0]):
        if frame.pts is not None and frame.time_base is not None:
            time = float(frame.pts * frame.time_base)
            start = time if start is None else start
            missing = round((time - start - count / rate) * rate)
            while missing > MAX_GAP_SECONDS * rate:
                size = min(missing, rate)
                yield SoundBlock(start + count / rate, np.zeros((channels, size), np.float32))
                count, missing = count + size, missing - size
        frame.pts = None
        for part in resampler.resample(frame):
            samples = part.to_ndarray().astype(np.float32)
            yield SoundBlock((start or 0.0) + count / rate, samples)
            count += samples.shape[1]


def measure_in_child(name: str, begin: float, seconds: float) -> dict[str, Any] | None:
    """Return the :class:`SoundLevel` of ``seconds`` s of a file's first soundtrack from the time ``begin``, or None if
    it has no soundtrack. Runs in a child process. Raises UserError."""
    path = Path(name)
    with _opened(path) as container:
        if not container.streams.audio:
            return None
        rate, channels = _properties(container)
        total, clipped, count = 0.0, 0, 0
        for block in _span(path, container, begin, seconds, channels):
            total += float(np.square(block, dtype=np.float64).sum())
            clipped += int((np.abs(block) >= CLIPPED).sum())
            count += block.size
    return asdict(SoundLevel(rate, channels, (total / max(count, 1)) ** 0.5, clipped / max(count, 1)))


def encode_in_child(name: str, begin: float, seconds: float) -> tuple[int, bytes]:
    """Encode ``seconds`` s of a file's first soundtrack from the time ``begin`` as Opus. Runs in a child process.
    Returns the number of channels, and the Ogg file. Raises UserError."""
    path = Path(name)
    with _opened(path) as container:
        if not container.streams.audio:
            raise UserError(f"{path}: expected a file with a soundtrack, got none; name another file or camera")
        _, channels = _properties(container)
        return channels, encode_opus(_span(path, container, begin, seconds, channels), channels)


def _opened(path: Path) -> InputContainer:
    require_regular(path)
    limits = {"protocol_whitelist": "file", "format_whitelist": SOUND_CONTAINERS}
    try:
        return av.open(str(path), options=limits, metadata_errors="replace")
    except (av.FFmpegError, OSError, ValueError) as error:
        raise _damaged(path, error) from error


def _properties(container: InputContainer) -> tuple[int, int]:
    """Return the sampling rate in Hz of the first soundtrack, and the number of channels that are kept."""
    stream = container.streams.audio[0]
    return int(stream.rate or 0), 1 if stream.channels == 1 else 2


def _span(path: Path, container: InputContainer, begin: float, seconds: float, channels: int) -> Iterator[Samples]:
    count = round(seconds * RATE)
    try:
        yield from cut(_from(container, begin, channels, count), 0, count, channels)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise _damaged(path, error) from error


def _from(container: InputContainer, begin: float, channels: int, count: int) -> Iterator[Samples]:
    """Yield the samples from the time ``begin`` on. If the sound starts later, up to ``count`` samples of silence come
    first."""
    position: int | None = None
    for block in decode_blocks(container, RATE, LAYOUTS[channels]):
        if position is None:
            position = round((block.seconds - begin) * RATE)
            if position > 0:
                yield from silence(min(position, count), channels)
        end = position + block.samples.shape[1]
        if end > 0:
            yield block.samples[:, max(-position, 0) :]
        position = end


def _damaged(path: Path, error: Exception) -> UserError:
    reason = getattr(error, "strerror", None) or str(error)
    return UserError(
        f"{path}: expected a soundtrack that can be decoded, got '{reason}'; copy the file again, or choose another "
        "sound with --sound"
    )
