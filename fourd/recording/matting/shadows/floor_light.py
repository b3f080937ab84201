"""The light on the floor at one time: how dark the floor is at each place, according to most cameras.

A camera that sees the subject in front of a place of the floor sees another colour there than the other cameras do. The
light of the floor therefore tells the subject from its shadow, even where both are equally grey.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera
from fourd.recording.matting.shadows.floor import Floor, median_of
from fourd.recording.matting.shadows.observed_light import ObservedLight

Floats = NDArray[np.float32]

MARGIN = 0.3
"""How far the floor reaches beyond the subject's box, as a fraction of the box's longest side. Shadows do too."""
MAX_CELLS = 400
"""Largest number of cells along a side of the floor."""
MIN_VIEWS = 4
MIN_AGREEING_VIEWS = 3
MAX_SPREAD = 0.08
"""Cameras agree about a cell if the light that they see differs from the median by at most this."""
MIN_AGREEING = 0.3
"""Fraction of the cameras that must agree about a cell. The subject stands between the cell and the others."""
MAX_PROBABILITY = 0.8
DARKEST, BRIGHTEST = 0.35, 1.1


@dataclass(frozen=True, eq=False)
class FloorLight:
    """The light on the floor as one camera sees it.

    Attributes:
        light: (h, w) light of the floor at each pixel, according to all cameras.
        probability: (h, w) probability in [0, 1] of this light; 0 where the pixel does not show the floor.
    """

    light: Floats
    probability: Floats


@dataclass(frozen=True, eq=False)
class FloorGrid:
    """Cells of the floor around the subject, and their homographies into the cameras.

    Attributes:
        shape: number of rows and columns of cells.
        sizes: width and height of each camera's image in pixels.
        homographies: for each camera, the matrix (3, 3) that maps homogeneous cells (column, row, 1) to pixels. The
            third component of the result is the depth of the cell.
    """

    shape: tuple[int, int]
    sizes: tuple[tuple[int, int], ...]
    homographies: tuple[Array, ...]

    @staticmethod
    def covering(floor: Floor, corners: Array, size: float, cameras: Sequence[Camera]) -> FloorGrid:
        """Divide the floor around the subject into cells.

        Args:
            floor: the floor's plane.
            corners: (2, 3) lower and upper corner of the subject's box in world units.
            size: side of a cell in world units, if no side of the floor has more than MAX_CELLS cells then.
            cameras: the cameras.
        """
        axis = np.eye(3)[int(np.argmin(np.abs(floor.normal)))]
        first = np.cross(floor.normal, axis)
        first /= np.linalg.norm(first)
        axes = np.stack([first, np.cross(floor.normal, first)])
        places = np.stack(np.meshgrid(*corners.T), -1).reshape(-1, 3) @ axes.T
        margin = MARGIN * float((corners[1] - corners[0]).max())
        lower, upper = places.min(axis=0) - margin, places.max(axis=0) + margin
        size = max(size, float((upper - lower).max()) / MAX_CELLS)
        columns, rows = (int(count) for count in np.ceil((upper - lower) / size))
        origin = floor.offset * floor.normal + (lower + size / 2) @ axes
        to_world = np.column_stack([size * axes[0], size * axes[1], origin])
        # Pixel centres have the coordinates 0.5, 1.5 and so on, and OpenCV's are 0, 1 and so on.
        shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
        homographies = []
        for camera in cameras:
            in_camera = camera.rotation @ to_world
            in_camera[:, 2] += camera.translation
            homographies.append(shift @ camera.intrinsics @ in_camera)
        return FloorGrid((rows, columns), tuple((each.width, each.height) for each in cameras), tuple(homographies))

    def light(self, views: Sequence[ObservedLight]) -> list[FloorLight]:
        """Return the light on the floor for each camera, from the images of all cameras at one time."""
        on_floor = [self._on_floor(*each) for each in zip(views, self.homographies, strict=True)]
        light, shaded, known = (np.stack(each) for each in zip(*on_floor, strict=True))
        shaded &= (light > DARKEST) & (light < BRIGHTEST)
        typical = median_of(light, shaded)
        agreeing = (shaded & (np.abs(light - typical) < MAX_SPREAD)).sum(axis=0)
        seen = known.sum(axis=0)
        share = agreeing / np.maximum(seen, 1)
        probability = MAX_PROBABILITY * np.clip((share - MIN_AGREEING) / (1 - MIN_AGREEING), 0, 1).astype(np.float32)
        is_certain = (seen >= MIN_VIEWS) & (agreeing >= MIN_AGREEING_VIEWS)
        probability = np.where(is_certain, probability, np.float32(0))
        typical = np.where(is_certain, typical, np.float32(1))
        return [self._in_image(typical, probability, *each) for each in zip(self.homographies, self.sizes, strict=True)]

    def _on_floor(self, view: ObservedLight, homography: Array) -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]:
        """Return the light, and where it is a shaded and a known background, at the cells as one camera sees them."""
        rows, columns = self.shape
        is_before = _third(homography, columns, rows) > 0

        def warp(picture: NDArray[np.generic]) -> Floats:
            return np.asarray(
                cv2.warpPerspective(
                    picture.astype(np.float32),
                    homography,
                    (columns, rows),
                    flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                ),
                np.float32,
            )

        return warp(view.light), (warp(view.is_shaded) > 0.99) & is_before, (warp(view.is_known) > 0.99) & is_before

    def _in_image(self, light: Floats, probability: Floats, homography: Array, size: tuple[int, int]) -> FloorLight:
        inverse: Array = np.linalg.inv(homography).astype(np.float64)
        # The third component is the inverse depth of the floor at a pixel, which is negative above the horizon.
        is_before = _third(inverse, *size) > 0
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        seen = cv2.warpPerspective(probability, inverse, size, flags=flags)
        shown = cv2.warpPerspective(light, inverse, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return FloorLight(np.asarray(shown, np.float32), np.where(is_before, seen, np.float32(0)))


def _third(matrix: Array, width: int, height: int) -> Array:
    """Return the third component (height, width) of ``matrix`` applied to (column, row, 1)."""
    return np.asarray(
        matrix[2, 0] * np.arange(width) + matrix[2, 1] * np.arange(height)[:, None] + matrix[2, 2], np.float64
    )
