"""Soundtracks with known offsets, and small videos with sound."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from tests.capture.numbered_videos import HEIGHT, WIDTH, numbered_picture

Samples = NDArray[np.float32]

RATE = 48_000


def room_sound(seconds: float, rng: np.random.Generator) -> Samples:
    """Synthetic sound (N,) at 48 kHz: quiet noise, and bursts of noise that start at random times and decay, like
    claps."""
    count = round(seconds * RATE)
    sound = 0.02 * np.cumsum(rng.normal(0, 0.1, count))
    sound -= np.convolve(sound, np.ones(401) / 401, "same")
    for start in rng.integers(0, count - 100, max(round(5 * seconds), 3)):
        length = min(round(0.06 * RATE), count - int(start))
        sound[start : start + length] += rng.normal(0, 0.3, length) * np.exp(-np.arange(length) / (0.012 * RATE))
    return np.asarray(sound, np.float32)


def recorded(sound: Samples, start: float, seconds: float, level: float, rng: np.random.Generator) -> Samples:
    """The part of ``sound`` that a camera records, ``seconds`` long from the time ``start``: multiplied by ``level``,
    with two echoes, and with noise at 20 dB SNR."""
    heard = sound.copy()
    for delay, gain in ((0.011 + 0.02 * rng.random(), 0.5), (0.035 + 0.02 * rng.random(), -0.35)):
        samples = round(delay * RATE)
        heard[samples:] += gain * sound[:-samples]
    part = heard[round(start * RATE) : round((start + seconds) * RATE)]
    noise = rng.normal(0, float(np.sqrt(np.mean(part**2))) / 10, len(part))
    return np.asarray(level * (part + noise), np.float32)


def write_video_with_sound(
    path: Path, frames: int, sound: Samples | None, *, fps: int = 10, first: int = 0, codec: str = "aac"
) -> Path:
    """Write a video of numbered images that start with the number ``first``. The video has a mono soundtrack at 48 kHz,
    unless ``sound`` is None."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        video = container.add_stream("libx264", rate=fps, options={"crf": "12"})
        video.width, video.height, video.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        audio = None if sound is None else container.add_stream(codec, rate=RATE, layout="mono")
        for number in range(frames):
            frame = av.VideoFrame.from_ndarray(numbered_picture(first + number), format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, fps)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
        if audio is not None and sound is not None:
            for start in range(0, len(sound), 1024):
                block = av.AudioFrame.from_ndarray(sound[None, start : start + 1024], format="fltp", layout="mono")
                block.sample_rate, block.pts, block.time_base = RATE, start, Fraction(1, RATE)
                container.mux(audio.encode(block))
            container.mux(audio.encode(None))
    return path
