"""Rendering of scenes and runs in a style, for `fourd render`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fourd.baking.playable import Playable
from fourd.baking.styled.player import StyledPlayer
from fourd.cameras import Camera
from fourd.stylize import Style
from fourd.viewer.playback.prefetch import BakedFrameSource


@dataclass(frozen=True)
class StyledPlayable:
    """A scene or a run that is rendered in a style.

    Attributes:
        plain: the scene or run, which supplies cameras and frame numbers.
        source: the baked frames of the scene or run.
        style: the style.
    """

    plain: Playable
    source: BakedFrameSource
    style: Style
    _player: StyledPlayer = field(default_factory=StyledPlayer)

    @property
    def views(self) -> dict[str, Camera]:
        return self.plain.views

    @property
    def focus(self) -> NDArray[np.float64]:
        return self.plain.focus

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        return self.plain.frame_numbers

    @property
    def fps(self) -> float:
        return self.plain.fps

    def render(
        self, camera: Camera, frame: int, layers: int | None, background: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Render a frame, as :meth:`fourd.baking.playable.Playable.render`."""
        red, green, blue = (float(value) for value in background)
        picture = self._player.draw(
            self.source.read(frame),
            camera,
            self.source.manifest,
            self.style,
            layers=layers,
            background=(red, green, blue),
        )
        return np.asarray(picture[..., :3] / np.float32(255), np.float32)
