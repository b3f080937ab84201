"""Rendering of scenes and runs through a lens, for `fourd render`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.baking.playable import Playable
from fourd.cameras import Camera
from fourd.lenses.inserts import Insert
from fourd.lenses.lens import Lens
from fourd.lenses.picture import draw_through_lens
from fourd.viewer.playback.prefetch import BakedFrameSource


@dataclass(frozen=True)
class LensPlayable:
    """A scene or a run that is rendered through a lens, by tracing rays.

    Attributes:
        plain: the scene or run, which supplies cameras and frame numbers.
        source: the baked frames of the scene or run.
        lens: the lens.
        inserts: mirrors and glass balls in the scene.
    """

    plain: Playable
    source: BakedFrameSource
    lens: Lens
    inserts: tuple[Insert, ...] = ()

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
        return draw_through_lens(
            self.source.read(frame),
            camera,
            self.source.manifest,
            self.lens,
            inserts=self.inserts,
            layers=layers,
            background=(red, green, blue),
        )
