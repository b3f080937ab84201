"""The part of the image that the points of a frame can cover."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.scene import BakedFrame
from fourd.viewer.display import RenderRequest

_BLOCK = 64
"""Number of points per row. :func:`_bounds` arranges the points as an array with this many points in each row, and
computes the minimum and maximum of each column. With one point (3 elements) per row, NumPy would be slow."""


@dataclass(frozen=True)
class ImageRegion:
    """The pixels with ``left`` <= column < ``right`` and ``top`` <= row < ``bottom``."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def is_empty(self) -> bool:
        """True if the region contains no pixels."""
        return self.right <= self.left or self.bottom <= self.top


class RegionFinder:
    """Computes the part of the image that the points of a frame can cover. The bounding box of the points is kept, so
    that it is not computed again while successive images show the same frame."""

    def __init__(self) -> None:
        self._frame: BakedFrame | None = None
        self._corners: NDArray[np.float64] = np.zeros((8, 3))

    def find(self, request: RenderRequest, margin: int | None) -> ImageRegion:
        """Return a region that contains all discs.

        The region extends one pixel past the discs, because the pixel filter averages blocks of 3 x 3 pixels. It
        is the whole image if the scene has a background, if a part of the box around the points is closer to the
        camera than the near plane, if the box is not finite, or if ``margin`` is None.

        Args:
            request: the frame, which has at least one point, and the camera.
            margin: maximum number of pixels by which a disc extends past its centre.
        """
        camera, frame = request.camera, request.frame
        whole = ImageRegion(0, 0, camera.width, camera.height)
        if margin is None or frame.background is not None:
            return whole
        if frame is not self._frame:
            lower, upper = _bounds(frame.xyz)
            self._corners = np.array(list(itertools.product(*zip(lower, upper, strict=True))))
            self._frame = frame
        in_camera = self._corners @ camera.rotation.T + camera.translation
        if not (np.isfinite(in_camera).all() and in_camera[:, 2].min() > request.manifest.near):
            return whole
        homogeneous = in_camera @ camera.intrinsics.T
        pixels = homogeneous[:, :2] / homogeneous[:, 2:]
        limits = (camera.width, camera.height)
        left, top = (int(v) for v in np.clip(np.floor(pixels.min(axis=0)) - margin - 1, 0, limits))
        right, bottom = (int(v) for v in np.clip(np.ceil(pixels.max(axis=0)) + margin + 1, 0, limits))
        return ImageRegion(left, top, right, bottom)


def _bounds(xyz: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and the largest coordinates (3,) of points (N, 3)."""
    blocks = len(xyz) // _BLOCK * _BLOCK
    parts = [xyz[blocks:]]
    if blocks:
        columns = xyz[:blocks].reshape(-1, 3 * _BLOCK)
        parts += [columns.min(axis=0).reshape(-1, 3), columns.max(axis=0).reshape(-1, 3)]
    extremes = np.concatenate(parts).astype(np.float64)
    return extremes.min(axis=0), extremes.max(axis=0)
