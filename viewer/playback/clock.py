"""Which frame is shown at which time."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass
class Playback:
    """A clock over the frames of a scene.

    Attributes:
        frames: how many there are, at least 1.
        fps: frames a second at speed 1.
        speed: factor; negative plays backwards.
        playing, looping: what the buttons say.
    """

    frames: int
    fps: float
    speed: float = 1.0
    playing: bool = True
    looping: bool = True
    _position: float = 0.0

    @property
    def frame(self) -> int:
        """The frame to show, from 0."""
        return min(int(self._position), self.frames - 1)

    @property
    def direction(self) -> int:
        """1 or -1: which frames come next."""
        return -1 if self.speed < 0 else 1

    def advance(self, seconds: float) -> None:
        """Let time pass; at an end, start again or stop there."""
        if not self.playing or self.frames < 2:
            return
        self._position += seconds * self.fps * self.speed
        if 0 <= self._position < self.frames:
            return
        if self.looping:
            self._position %= self.frames
        else:
            self._position = 0.0 if self._position < 0 else float(self.frames - 1)
            self.playing = False

    def seconds_to_next(self) -> float:
        """Until another frame is shown; infinite while none will be."""
        if not self.playing or self.frames < 2 or self.speed == 0:
            return math.inf
        within = self._position - int(self._position)
        frames = 1 - within if self.speed > 0 else within
        return frames / (self.fps * abs(self.speed))

    def seek(self, frame: int) -> None:
        """Go to a frame, brought into range."""
        self._position = float(min(max(frame, 0), self.frames - 1))

    def step(self, frames: int) -> None:
        """Stop, and go on by some frames, round the end."""
        self.playing = False
        self._position = float((self.frame + frames) % self.frames)

    def toggle(self) -> None:
        """Play or pause; from the last frame of a scene that does not loop, play from the first."""
        self.playing = not self.playing
        last = self.frames - 1 if self.direction > 0 else 0
        if self.playing and not self.looping and self.frame == last:
            self._position = 0.0 if self.direction > 0 else float(self.frames - 1)
