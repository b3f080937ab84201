"""Directions, heights and units of a scene that edits refer to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import estimate_up
from fourd.base.errors import UserError
from fourd.recording.capture.layout import sample_indices
from fourd.scene.editing.regions import Box, Cylinder, HalfSpace, Region
from fourd.scene.editing.similarity import Similarity
from fourd.scene.editing.sources import FrameSource

Array = NDArray[np.float64]

FLOOR_SHARE = 0.005
"""The floor is at the height below which this share of the subject's points is."""
_FLOOR_FRAMES = 8
AXES = {
    name: sign * np.eye(3)[axis]
    for axis, letter in enumerate("xyz")
    for name, sign in ((letter, 1), (f"-{letter}", -1))
}
"""Unit vectors by their names on the command line."""
CROP_FORMS = "box=X0,Y0,Z0,X1,Y1,Z1, cylinder=RADIUS, cylinder=RADIUS,X,Y,Z, above-floor or above-floor=HEIGHT"


@dataclass(frozen=True)
class SceneGeometry:
    """Measures of a scene, in world units."""

    source: FrameSource

    @cached_property
    def up(self) -> Array:
        """The up direction (3,): that of the cameras, or +z for a scene without cameras."""
        cameras = self.source.manifest.cameras
        return estimate_up(cameras) if cameras else np.array([0.0, 0.0, 1.0])

    @property
    def unit(self) -> float:
        """Length, in world units, of the unit in which the user states lengths: a metre if the scene knows it, or else
        a world unit."""
        metres = self.source.manifest.metres_per_unit
        return 1.0 if metres is None else 1.0 / metres

    @property
    def centre(self) -> Array:
        """The middle (3,) of the subject's bounds."""
        return np.asarray(self.source.manifest.bounds, np.float64).mean(axis=0)

    @cached_property
    def floor(self) -> float:
        """Coordinate of the floor along :attr:`up`, under the feet of the subject in a few frames."""
        heights = []
        for index in sample_indices(self.source.manifest.frame_count, _FLOOR_FRAMES):
            xyz = self.source.read_dynamic(index).xyz
            if len(xyz):
                heights.append(np.quantile(xyz @ self.up, FLOOR_SHARE))
        return float(min(heights, default=0.0))


def parse_region(text: str, geometry: SceneGeometry) -> Region:
    """Return the region that a value of --crop names. Raises UserError if it names none."""
    name, _, values = text.partition("=")
    try:
        numbers = np.array([float(word) for word in values.split(",")]) if values else np.zeros(0)
    except ValueError as error:
        raise _bad_region(text) from error
    unit = geometry.unit
    if not np.isfinite(numbers).all():
        raise _bad_region(text)
    if name == "box" and len(numbers) == 6 and (numbers[:3] < numbers[3:]).all():
        return Box(unit * numbers[:3], unit * numbers[3:])
    if name == "cylinder" and len(numbers) in (1, 4) and numbers[0] > 0:
        centre = geometry.centre if len(numbers) == 1 else unit * numbers[1:]
        return Cylinder(centre, geometry.up, unit * float(numbers[0]))
    if name == "above-floor" and len(numbers) <= 1:
        return HalfSpace(geometry.up, geometry.floor + unit * float(numbers.sum()))
    raise _bad_region(text)


def _bad_region(text: str) -> UserError:
    return UserError(f"--crop: expected {CROP_FORMS}, with X0 < X1 and so on, got '{text}'")


def upright(geometry: SceneGeometry, axis: str) -> Similarity:
    """Return the rotation about the origin that turns the up direction of a scene to the axis named ``axis``."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.align_vectors([AXES[axis]], [geometry.up])[0].as_matrix()
    return Similarity(1.0, np.asarray(rotation, np.float64), np.zeros(3))


def turned(up: Array, degrees: float) -> Similarity:
    """Return the rotation about the line through the origin along ``up``, counterclockwise as seen from above."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_rotvec(np.radians(degrees) * up).as_matrix()
    return Similarity(1.0, np.asarray(rotation, np.float64), np.zeros(3))


def shifted(offset: Array) -> Similarity:
    """Return the translation by ``offset`` (3,), in world units."""
    return Similarity(1.0, np.eye(3), np.asarray(offset, np.float64))
