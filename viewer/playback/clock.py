"""The playback clock, which selects the frame to show."""

from __future__ import annotations

import math
from dataclasses import dataclass

SPEEDS = (-1.0, -0.5, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Speeds that the time bar offers. At a negative speed, the scene plays backwards."""


@dataclass
class Playback:
    """A playback clock for the frames of a scene.

    Attributes:
        frame_count: number of frames, at least 1.
        fps: frames per second at speed 1.
        speed: factor by which ``fps`` is multiplied. At a negative speed, the scene plays backwards.
        is_playing: whether :meth:`advance` moves the clock.
        is_looping: whether playback wraps around at the first and the last frame, instead of pausing there.
    """

    frame_count: int
    fps: float
    speed: float = 1.0
    is_playing: bool = True
    is_looping: bool = True
    _position: float = 0.0

    @property
    def frame(self) -> int:
        """Index of the frame to show, from 0."""
        return min(int(self._position), self.frame_count - 1)

    @property
    def seconds(self) -> float:
        """Time of the scene in seconds."""
        return self._position / self.fps

    @property
    def direction(self) -> int:
        """1 for playback forwards, -1 for playback backwards."""
        return -1 if self.speed < 0 else 1

    def advance(self, seconds: float) -> None:
        """Advance the clock by ``seconds``. At the first or the last frame, playback wraps around or pauses."""
        if not self.is_playing or self.frame_count < 2:
            return
        self._position += seconds * self.fps * self.speed
        if 0 <= self._position < self.frame_count:
            return
        if self.is_looping:
            self._position %= self.frame_count
        else:
            self._position = 0.0 if self._position < 0 else float(self.frame_count - 1)
            self.is_playing = False

    def seconds_to_next_frame(self) -> float:
        """Return the seconds until the frame changes, which are infinite while the clock is paused."""
        if not self.is_playing or self.frame_count < 2 or self.speed == 0:
            return math.inf
        fraction = self._position - int(self._position)
        frames = 1 - fraction if self.speed > 0 else fraction
        return frames / (self.fps * abs(self.speed))

    def seek(self, frame: int) -> None:
        """Seek to a frame. Its index is clamped to the frames of the scene."""
        self._position = float(min(max(frame, 0), self.frame_count - 1))

    def step(self, frames: int) -> None:
        """Pause, and step by ``frames`` frames. The step wraps around at the first and the last frame."""
        self.is_playing = False
        self._position = float((self.frame + frames) % self.frame_count)

    def toggle(self) -> None:
        """Play or pause. If playback does not loop and has reached its last frame, it restarts at the first one."""
        self.is_playing = not self.is_playing
        last = self.frame_count - 1 if self.direction > 0 else 0
        if self.is_playing and not self.is_looping and self.frame == last:
            self._position = 0.0 if self.direction > 0 else float(self.frame_count - 1)
