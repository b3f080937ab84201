"""Time offsets between cameras, estimated from their soundtracks by GCC-PHAT.

GCC-PHAT (C. Knapp and G. Carter, "The generalized correlation method for estimation of time delay", 1976) uses only the
phase of the cross-spectrum, so cameras with different recording levels or microphones can be compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from fourd.base.errors import UserError
from fourd.recording.capture.video import open_container
from fourd.recording.soundtrack.reading import decode_blocks
from fourd.recording.sync.pairs import camera_confidence, solve_offsets

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

RATE = 8000
"""Sampling rate in Hz to which soundtracks are converted."""
MAX_SECONDS = 300.0
"""Maximum duration, in seconds, of the part of a soundtrack that is used. It limits the memory to 10 MB per camera."""
LOW_HZ, HIGH_HZ = 200.0, 3000.0
"""Lower and upper frequency of the pass band in Hz. Wind and handling noise are mostly below the pass band, and much of
the noise of phones is above it."""
MAX_LAG_SECONDS = 60.0
MIN_OVERLAP_SECONDS = 0.25
SILENCE_RMS = 1e-4
"""Level below which a soundtrack is treated as silent, as a fraction of full scale. The value corresponds to -80 dB."""
ECHO_SECONDS = 0.06
"""A correlation peak counts as an echo of the highest peak if their lags differ by at most this number of seconds."""
NOISE_SIGMAS, SURE_SIGMAS = 10.0, 20.0
"""Heights of the correlation peak at which a camera pair's confidence is 0 and 1, in standard deviations of the
correlation.

For short clips without common sound, the highest value of the correlation was below 11 standard deviations, which gives
a confidence below 0.1.
"""
MAX_LAG_ERROR_SECONDS = 0.003
LAG_TOLERANCE_SECONDS = 2e-4
MAX_ALL_PAIRS = 6
"""Maximum number of cameras for which all pairs of cameras are correlated. If there are more cameras, each camera is
correlated with the first camera and with the next camera."""
SPEED_OF_SOUND = 343.0
"""Speed of sound in air at 20 degrees Celsius in m/s."""


@dataclass(frozen=True, eq=False)
class Soundtrack:
    """The soundtrack of a video.

    Attributes:
        samples: (N,) mono samples at 8 kHz, relative to full scale.
        start: time in seconds of the first sample, relative to the video's first frame; can be negative.
    """

    samples: Samples
    start: float

    @property
    def is_silent(self) -> bool:
        return not len(self.samples) or float(np.sqrt(np.mean(np.square(self.samples)))) < SILENCE_RMS


@dataclass(frozen=True)
class SoundOffsets:
    """Time offset of each camera's video relative to the first camera's video.

    Attributes:
        seconds: offsets. A sound at the time t of the first camera's video is at the time t + offset of the other
            camera's video.
        confidence: confidence of each offset in [0, 1]. A camera's confidence is the mean confidence of the better half
            of the pairs of cameras that include it. A pair's confidence depends on the height of the correlation's
            highest peak: it is 0 up to 10 standard deviations of the correlation, 1 from 20 standard deviations on, and
            linear in between. It is reduced if another peak, more than 60 ms away, is higher than 3/4 of the highest
            peak. The confidence of a pair is 0 if its lag differs by more than 3 ms from the difference of the two
            cameras' offsets.
        sigmas: for each camera, height of the highest correlation peak among its pairs, in standard deviations of the
            correlation.
    """

    seconds: tuple[float, ...]
    confidence: tuple[float, ...]
    sigmas: tuple[float, ...]


def read_soundtrack(path: Path, video_start: float) -> Soundtrack | None:
    """Decode the first 5 minutes of the first soundtrack of a video. Returns None if the video has no soundtrack.

    Args:
        path: the video file.
        video_start: presentation time, in seconds, of the first frame of the video.

    Raises:
        UserError: if the soundtrack is damaged.
    """
    blocks: list[Samples] = []
    start, count = 0.0, 0
    try:
        with open_container(path) as container:
            if not container.streams.audio:
                return None
            for block in decode_blocks(container, RATE, "mono"):
                start = start if blocks else block.seconds
                blocks.append(block.samples[0])
                count += len(blocks[-1])
                if count >= MAX_SECONDS * RATE:
                    break
    except (av.FFmpegError, OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UserError(
            f"{path}: expected a soundtrack that can be decoded, got '{reason}'; copy the file again, or use "
            "--sync-by motion"
        ) from error
    samples = np.concatenate(blocks) if blocks else np.zeros(0, np.float32)
    return Soundtrack(samples[: round(MAX_SECONDS * RATE)], start - video_start)


def estimate_sound_offsets(soundtracks: Sequence[Soundtrack]) -> SoundOffsets:
    """Estimate the time offset of each camera relative to the first camera, from sound that all cameras have recorded.

    The soundtracks of pairs of cameras are correlated by GCC-PHAT from 200 to 3000 Hz. A parabola through the peak of
    the correlation gives the lag with sub-sample accuracy. The offsets are fitted to the lags of the pairs. They
    include the time that sound travels from its source to each camera; see :func:`travel_times`.

    Args:
        soundtracks: the soundtrack of each camera. At least one soundtrack is required, and none may be silent.

    Raises:
        ValueError: if a soundtrack is silent, or if there is no soundtrack.
    """
    if not soundtracks or any(track.is_silent for track in soundtracks):
        raise ValueError("soundtracks: expected at least one soundtrack, none of them silent")
    count = len(soundtracks)
    pairs = list(combinations(range(count), 2))
    if count > MAX_ALL_PAIRS:
        pairs = [(i, j) for i, j in pairs if i == 0 or j == i + 1]
    found = [_estimate_lag(soundtracks[i], soundtracks[j]) for i, j in pairs]
    lags = np.array([lag for lag, _, _ in found])
    weights = np.array([weight for _, weight, _ in found])
    solution = solve_offsets(pairs, lags, weights, count, LAG_TOLERANCE_SECONDS)
    agreed, sigmas = [], [0.0] * count
    for (i, j), lag, weight, (_, _, peak) in zip(pairs, lags, weights, found, strict=True):
        is_same = abs(solution[j] - solution[i] - lag) <= MAX_LAG_ERROR_SECONDS
        agreed.append((float(weight) if is_same else 0.0, (i, j)))
        sigmas[i], sigmas[j] = max(sigmas[i], peak), max(sigmas[j], peak)
    confidence = [camera_confidence([weight for weight, pair in agreed if camera in pair]) for camera in range(count)]
    return SoundOffsets(tuple(map(float, solution)), tuple(confidence), tuple(sigmas))


def travel_times(centres: Mapping[str, Array], source: Array) -> dict[str, float]:
    """Return the time in seconds that sound travels from ``source`` to each camera, at 343 m/s.

    Args:
        centres: maps the name of each camera to its position (3,) in metres.
        source: (3,) position of the sound source in metres.
    """
    return {name: float(np.linalg.norm(centre - source)) / SPEED_OF_SOUND for name, centre in centres.items()}


def _estimate_lag(first: Soundtrack, second: Soundtrack) -> tuple[float, float, float]:
    """Find the lag of the second soundtrack relative to the first by GCC-PHAT.

    Returns:
        the lag in seconds (the time of a sound in the second video minus its time in the first video), the weight of
        the pair in [0, 1], and the height of the peak in standard deviations.
    """
    shortest = min(len(first.samples), len(second.samples))
    reach = max(len(first.samples), len(second.samples)) - round(MIN_OVERLAP_SECONDS * RATE)
    limit = max(1, min(round(MAX_LAG_SECONDS * RATE), reach))
    if shortest < MIN_OVERLAP_SECONDS * RATE:
        return 0.0, 0.0, 0.0
    correlation = _phat(first.samples, second.samples, limit)
    top = int(correlation.argmax())
    peak = float(correlation[top])
    deviation = 1.4826 * float(np.median(np.abs(correlation))) + 1e-12
    echo = round(ECHO_SECONDS * RATE)
    others = np.concatenate([correlation[: max(top - echo, 0)], correlation[top + echo + 1 :]])
    lead = 4 * (1 - float(others.max(initial=0)) / max(peak, 1e-12))
    sigmas = peak / deviation
    weight = np.clip((sigmas - NOISE_SIGMAS) / (SURE_SIGMAS - NOISE_SIGMAS), 0, 1) * np.clip(lead, 0, 1)
    fraction = 0.0
    if 0 < top < len(correlation) - 1:
        left, right = float(correlation[top - 1]), float(correlation[top + 1])
        curvature = left - 2 * peak + right
        fraction = 0.5 * (left - right) / curvature if curvature < -1e-12 else 0.0
    return (top - limit + fraction) / RATE + second.start - first.start, float(weight), sigmas


def _phat(first: Samples, second: Samples, limit: int) -> Array:
    """Correlate two signals by their phases in the pass band. Return an array (2 * limit + 1,) with the correlation at
    each lag from -limit to limit samples.

    If one signal is a delayed copy of the other signal, the correlation is 1 at the lag of the delay.
    """
    size = next_fast_len(max(len(first) + len(second), 2 * limit + 1), real=True)
    cross = np.conj(rfft(first, size)) * rfft(second, size)
    frequencies = rfftfreq(size, 1 / RATE)
    band = np.clip((frequencies - LOW_HZ) / 100, 0, 1) * np.clip((HIGH_HZ - frequencies) / 200, 0, 1)
    cross *= band / np.maximum(np.abs(cross), 1e-20)
    correlation = irfft(cross, size) * size / (2 * band.sum())
    return np.concatenate([correlation[-limit:], correlation[: limit + 1]]).astype(np.float64)
