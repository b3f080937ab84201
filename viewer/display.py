"""The input of renderers: a frame, a camera and display settings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fourd.base.cameras import Camera
from fourd.scene import BakedFrame, SceneManifest
from fourd.scene.scene import make_frame
from fourd.scene.styles import Style, without_paper

MIN_SCALE, MAX_SCALE = 0.1, 10.0
"""Smallest and largest scale factor for point size and density in the panel."""
DEFAULT_BACKGROUND = (0.09, 0.094, 0.102)
"""Background colour of windows, pages, images and videos, unless the user chooses another one: a dark grey, on which
black parts of a subject are visible."""


@dataclass(frozen=True)
class CropBox:
    """An axis-aligned box, in world units, outside which points are not drawn.

    Attributes:
        lower: corner with the smallest coordinates.
        upper: corner with the largest coordinates.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def apply(self, frame: BakedFrame) -> BakedFrame:
        """Return the points of ``frame`` that are in the box.

        The result is never empty, because renderers need a point: a point that nobody sees stands for none.
        """
        lower, upper = np.asarray(self.lower, np.float32), np.asarray(self.upper, np.float32)
        is_inside = ((frame.xyz >= lower) & (frame.xyz <= upper)).all(axis=1)
        if not is_inside.any():
            arrays = {name: array[:1] for name, array in frame.arrays.items()}
            return make_frame({**arrays, "density": np.zeros_like(arrays["density"])})
        return make_frame({name: array[is_inside] for name, array in frame.arrays.items()})


@dataclass(frozen=True)
class DisplaySettings:
    """The settings in the Display section of the panel.

    Attributes:
        layers: the maximum number K of points composited per pixel.
        background: background colour as red, green and blue in [0, 1].
        point_scale: factor by which the points' radii are multiplied.
        density_scale: factor by which the points' densities are multiplied. The scaled densities are clamped to 1.
        style: the style in which the scene is drawn, such as a cartoon, or None for the captured colours.
        has_own_background: whether the user has chosen the background, which then replaces the paper of styles.
        crop: box outside which points are not drawn, or None.
    """

    layers: int = 12
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    point_scale: float = 1.0
    density_scale: float = 1.0
    style: Style | None = None
    has_own_background: bool = False
    crop: CropBox | None = None

    def with_background(self, colour: tuple[float, float, float]) -> DisplaySettings:
        """Return the settings with a background that the user has chosen."""
        return replace(self, background=colour, has_own_background=True)

    @property
    def drawn(self) -> DisplaySettings:
        """The settings for renderers, in which the chosen background has replaced the paper of the style."""
        if self.style is None or not self.has_own_background:
            return self
        return replace(self, style=without_paper(self.style))

    @property
    def colour_behind(self) -> tuple[float, float, float]:
        """The colour where the scene has no points: the paper of the style, or the background."""
        style = self.drawn.style
        return self.background if style is None or style.paper is None else style.paper

    def scale_points(self, frame: BakedFrame) -> BakedFrame:
        """Return the points of ``frame`` in the crop box with scaled radii and densities, or ``frame`` itself if there
        is no box and both scale factors are 1.

        The arrays of the result still contain the background points, but its attribute ``background`` is None. This
        attribute refers to the background points that all frames share, and the changed points differ from these.
        """
        if self.crop is not None:
            frame = self.crop.apply(frame)
        if self.point_scale == 1.0 and self.density_scale == 1.0:
            return frame
        max_radius = float(np.finfo(np.float16).max)
        radius = np.minimum(frame.radius.astype(np.float32) * self.point_scale, max_radius)
        density = np.minimum(frame.density.astype(np.float32) * self.density_scale, 1.0)
        arrays = {"radius": radius.astype(np.float16), "density": density.astype(np.float16)}
        return replace(frame, **arrays, background=None, has_shadow=False)


@dataclass(frozen=True, eq=False)
class RenderRequest:
    """The input of every renderer.

    Attributes:
        frame: the arrays to draw, already scaled by :meth:`DisplaySettings.scale_points`.
        camera: a pinhole camera without distortion. The camera's size is the size of the image.
        manifest: the manifest of the scene.
        settings: supplies the number of layers K and the background colour. Renderers ignore the point scales in
            ``settings``, because the points of ``frame`` are already scaled.
    """

    frame: BakedFrame
    camera: Camera
    manifest: SceneManifest
    settings: DisplaySettings
