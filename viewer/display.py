"""How a scene is shown, apart from where it is seen from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fourd.baking import BakedFrame, SceneManifest
from fourd.cameras import Camera

SMALLEST_SCALE, LARGEST_SCALE = 0.1, 10.0


@dataclass(frozen=True)
class DisplaySettings:
    """What the panel's sliders set.

    Attributes:
        layers: points that a pixel composites, K.
        background: red, green and blue in [0, 1].
        point_scale: factor on the points' radii.
        density_scale: factor on their densities, which stay at most 1.
    """

    layers: int = 12
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    point_scale: float = 1.0
    density_scale: float = 1.0

    def applied(self, frame: BakedFrame) -> BakedFrame:
        """The frame with radii and densities scaled; itself where both scales are 1."""
        if self.point_scale == 1.0 and self.density_scale == 1.0:
            return frame
        largest = float(np.finfo(np.float16).max)
        radius = np.minimum(frame.radius.astype(np.float32) * self.point_scale, largest)
        density = np.minimum(frame.density.astype(np.float32) * self.density_scale, 1.0)
        return replace(frame, radius=radius.astype(np.float16), density=density.astype(np.float16))


@dataclass(frozen=True, eq=False)
class RenderRequest:
    """What a renderer is asked for: a frame, from a camera, in a settings.

    ``frame`` has the settings's scales applied already: they are the arrays that every renderer reads.
    """

    frame: BakedFrame
    camera: Camera
    manifest: SceneManifest
    settings: DisplaySettings
