"""Draws scenes and training runs in a style or through a lens model, for `fourd render`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene import BakedFrame, SceneManifest
from fourd.scene.lenses.inserts import Insert
from fourd.scene.lenses.lens import Lens
from fourd.scene.lenses.picture import draw_through_lens
from fourd.scene.playable import Bounds, Playable
from fourd.scene.styled.player import StyledPlayer
from fourd.scene.styles import Style
from fourd.viewer.playback.prefetch import BakedFrameSource

Colour = tuple[float, float, float]


class Drawer(Protocol):
    """Draws baked frames."""

    def draw(
        self, frame: BakedFrame, camera: Camera, manifest: SceneManifest, layers: int | None, background: Colour
    ) -> NDArray[np.float32]:
        """Draw a frame. Returns RGB (H, W, 3) float32 in [0, 1]."""


@dataclass(frozen=True)
class StyleDrawer:
    """Draws frames in a style."""

    style: Style
    _player: StyledPlayer = field(default_factory=StyledPlayer)

    def draw(
        self, frame: BakedFrame, camera: Camera, manifest: SceneManifest, layers: int | None, background: Colour
    ) -> NDArray[np.float32]:
        picture = self._player.draw(frame, camera, manifest, self.style, layers=layers, background=background)
        return np.asarray(picture[..., :3] / np.float32(255), np.float32)


@dataclass(frozen=True)
class LensDrawer:
    """Draws frames through a lens, by tracing rays. ``inserts`` are mirrors and glass balls that are added to the
    scene."""

    lens: Lens
    inserts: tuple[Insert, ...] = ()

    def draw(
        self, frame: BakedFrame, camera: Camera, manifest: SceneManifest, layers: int | None, background: Colour
    ) -> NDArray[np.float32]:
        return draw_through_lens(
            frame, camera, manifest, self.lens, inserts=self.inserts, layers=layers, background=background
        )


@dataclass(frozen=True)
class DrawnPlayable:
    """A scene or a run whose baked frames are drawn by ``drawer``.

    Attributes:
        plain: the scene or run without a style or lens, which supplies the cameras and the frame numbers.
        source: the baked frames of the scene or run.
        drawer: draws the frames.
    """

    plain: Playable
    source: BakedFrameSource
    drawer: Drawer

    @property
    def views(self) -> dict[str, Camera]:
        return self.plain.views

    @property
    def focus(self) -> NDArray[np.float64]:
        return self.plain.focus

    @property
    def bounds(self) -> Bounds | None:
        return self.plain.bounds

    @property
    def is_whole(self) -> bool:
        return self.plain.is_whole

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        return self.plain.frame_numbers

    @property
    def fps(self) -> float:
        return self.plain.fps

    def render(
        self, camera: Camera, frame: int, layers: int | None, background: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Render a frame, with the arguments of :meth:`fourd.scene.playable.Playable.render`."""
        red, green, blue = (float(value) for value in background)
        return self.drawer.draw(self.source.read(frame), camera, self.source.manifest, layers, (red, green, blue))
