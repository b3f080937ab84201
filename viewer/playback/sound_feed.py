"""Supplies the samples of a scene's sound to a sound device, at the times of the picture."""

from __future__ import annotations

import threading
import time

import numpy as np
from numpy.typing import NDArray

from fourd.recording.soundtrack.ogg import RATE
from fourd.recording.soundtrack.opus import cut, decode_opus
from fourd.scene.files.sound import OpusSound

MAX_DRIFT_SECONDS = 0.04
"""If the sound is this time ahead of or behind the picture, it jumps to the time of the picture."""
FADE = round(0.004 * RATE)
"""Number of samples in which sound fades in and out, so that jumps make no clicks."""
ALONE_SECONDS = 1.0
"""The sound stops after this time if nobody follows the picture, for example while a video is rendered."""

Block = NDArray[np.float32]


class SoundFeed:
    """The samples of a scene, as long as the scene. :meth:`follow` tells the time of the picture, and :meth:`fill`,
    which another thread calls, returns the samples that a device plays next.

    Times are those of one clock, such as the clock of the sound device, in seconds.
    """

    def __init__(self, samples: NDArray[np.int16]) -> None:
        """``samples`` (N, C) are at 48 kHz."""
        self._samples = samples
        self._lock = threading.Lock()
        self._position = 0.0  # index of the next sample
        self._speed = 1.0
        self._gain = 0.0
        self._is_running = False
        self._is_looping = True
        self._jump: tuple[float, float] | None = None  # a time, and the sample that is to be heard at this time
        self._heard = (0.0, 0.0)  # the same of the last block
        self._followed = -ALONE_SECONDS
        self.jumps = 0

    @property
    def channels(self) -> int:
        return int(self._samples.shape[1])

    def follow(self, seconds: float, speed: float, now: float, *, is_running: bool, is_looping: bool = True) -> None:
        """Set the time of the picture.

        Args:
            seconds: the time of the scene that the picture shows at the time ``now``.
            speed: how fast the picture plays; negative if it plays backwards.
            now: the time of the clock.
            is_running: whether the picture plays. Otherwise, the sound fades out.
            is_looping: whether the scene begins again at its end.
        """
        with self._lock:
            is_new = not self._is_running or speed != self._speed
            self._followed = time.monotonic()
            self._is_looping = is_looping
            if is_running and (is_new or abs(self._drift(seconds, now)) > MAX_DRIFT_SECONDS):
                self._jump = (now, seconds * RATE)
                self._speed = speed
                self.jumps += 1
            self._is_running = is_running

    def drift(self, seconds: float, now: float) -> float:
        """Return how far the sound is ahead of the time ``seconds`` of the picture, in seconds."""
        with self._lock:
            return self._drift(seconds, now)

    def fill(self, out: Block, at: float) -> None:
        """Write the next samples to ``out`` (n, C). The first of them is heard at the time ``at``."""
        with self._lock:
            count, before = len(out), None
            if self._jump is not None:
                if self._gain:
                    before = self._read(count)
                moment, sample = self._jump
                self._position, self._jump = sample + (at - moment) * RATE * self._speed, None
                self._gain = 0.0 if before is None else self._gain
            self._heard = (at, self._position)
            is_heard = self._is_running and time.monotonic() - self._followed < ALONE_SECONDS
            rising = np.minimum(np.arange(1, count + 1, dtype=np.float32) / FADE, 1)[:, None]
            block = self._read(count)
            if before is not None:
                block = before + (block - before) * rising
            start, end = self._gain, 1.0 if is_heard else 0.0
            out[:] = block * (start + (end - start) * rising)
            self._gain = end
            self._position += count * self._speed

    def _drift(self, seconds: float, now: float) -> float:
        at, sample = self._heard if self._jump is None else self._jump
        error = sample / RATE + (now - at) * self._speed - seconds
        length = len(self._samples) / RATE
        return error - length * round(error / length) if self._is_looping else error

    def _read(self, count: int) -> Block:
        """Return the next samples, interpolated if the speed is not 1."""
        places = self._position + self._speed * np.arange(count)
        whole = np.floor(places).astype(np.int64)
        total = len(self._samples)
        block = self._samples[whole % total].astype(np.float32)
        if self._speed != 1 or self._position % 1:
            share = (places - whole).astype(np.float32)[:, None]
            block += share * (self._samples[(whole + 1) % total] - block)
        if not self._is_looping:
            block[(whole < 0) | (whole >= total)] = 0
        return block / np.float32(32768)


def decode_scene_sound(sound: OpusSound, channels: int, seconds: float) -> NDArray[np.int16]:
    """Decode the sound of a scene of ``seconds`` s. Returns (N, C), 11 MB a minute in stereo, with silence before its
    start and after its end. Raises :class:`~fourd.recording.soundtrack.ogg.OggError`."""
    samples = np.zeros((max(round(seconds * RATE), 1), channels), np.int16)
    position = 0
    for block in cut(decode_opus(sound.content), -round(sound.start * RATE), len(samples), channels):
        samples[position : position + block.shape[1]] = np.rint(np.clip(block.T, -1, 1) * 32767)
        position += block.shape[1]
    return samples
