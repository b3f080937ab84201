"""A scene whose ball flashes at the moment of a clap, and its sound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fourd.recording.soundtrack.opus import Samples, encode_opus
from fourd.scene import SceneWriter
from fourd.scene.files.sound import OpusSound
from tests.baking.scenes import manifest, random_frame

RATE = 48000
FPS = 30


def clap(seconds: float, *times: float, channels: int = 1) -> Samples:
    """Silence (C, N) with a burst of 5 ms of noise at each of the times."""
    rng = np.random.default_rng(0)
    sound = np.zeros((channels, round(seconds * RATE)), np.float32)
    for time in times:
        start = round(time * RATE)
        sound[:, start : start + 240] = rng.uniform(-0.8, 0.8, 240)[: sound.shape[1] - start]
    return sound


def onsets(samples: Samples, level: float = 0.1) -> list[float]:
    """The times in seconds at which a sound (C, N) starts after at least 0.1 s of silence."""
    loud = np.flatnonzero(np.abs(samples).max(axis=0) > level)
    first = np.concatenate([[True], np.diff(loud) > RATE // 10]) if len(loud) else np.zeros(0, bool)
    return [float(index) / RATE for index in loud[first]]


def write_clap_scene(path: Path, frames: int = 60, at: int = 20, points: int = 300, start: float = 0.0) -> Path:
    """Write a scene at 30 frames per second that claps when the frame ``at`` begins. In this frame, it is white, in the
    others it is dark. The sound starts ``start`` s after the first frame."""
    described = replace(manifest(6, frames), fps=float(FPS), is_fps_known=True)
    with SceneWriter(path, described) as writer:
        for index in range(frames):
            frame = random_frame(points, 6, seed=0)
            rgb = np.full_like(frame.rgb, 255 if index == at else 40)
            writer.add_frame(index, replace(frame, rgb=rgb))
        sound = clap(frames / FPS - start, at / FPS - start)
        writer.add_sound(OpusSound(encode_opus([sound], 1), start))
    return path
