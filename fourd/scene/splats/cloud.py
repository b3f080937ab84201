"""Gaussian splats: the points of one frame in the form that other programs use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.shade.harmonics import SH_CONSTANT, harmonics_rotation

LARGEST = 1e9
"""Maximum absolute value of the numbers of a splat."""
SMALLEST_SCALE = 1e-10
TERMS_BY_DEGREE = (1, 4, 9, 16)
"""Number of spherical harmonics of degrees 0 to D, for D = 0, 1, 2 and 3."""


@dataclass(frozen=True, eq=False)
class SplatCloud:
    """N Gaussian splats.

    Attributes:
        xyz: (N, 3) float32, centres in world units.
        scale: (N, 3) float32, standard deviations along the splat's axes in world units, above 0.
        rotation: (N, 4) float32, unit quaternions (w, x, y, z) from the splat's axes to the world.
        opacity: (N,) float32 in [0, 1], at the centre of the splat.
        sh: (N, 3, T) float32, spherical-harmonics coefficients, where T is 1, 4, 9 or 16. The colour is ``0.5 + sum(sh
            * Y(d))``, where Y(d) are the T spherical harmonics in the unit direction d from the camera to the splat.

    Raises:
        ValueError: for a wrong shape. The message names the array.
    """

    xyz: NDArray[np.float32]
    scale: NDArray[np.float32]
    rotation: NDArray[np.float32]
    opacity: NDArray[np.float32]
    sh: NDArray[np.float32]

    def __post_init__(self) -> None:
        count = len(self.xyz)
        shapes = {"xyz": (count, 3), "scale": (count, 3), "rotation": (count, 4), "opacity": (count,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name}: expected shape {shape}, got {getattr(self, name).shape}")
        if self.sh.shape[:2] != (count, 3) or self.sh.shape[-1] not in TERMS_BY_DEGREE:
            raise ValueError(f"sh: expected shape ({count}, 3, T) with T of {TERMS_BY_DEGREE}, got {self.sh.shape}")

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def degree(self) -> int:
        """Largest degree of the spherical harmonics, 0 to 3."""
        return TERMS_BY_DEGREE.index(self.sh.shape[-1])

    @property
    def base_colour(self) -> NDArray[np.float32]:
        """(N, 3) mean colour over all directions, clamped to [0, 1]."""
        return np.clip(0.5 + SH_CONSTANT * self.sh[..., 0], 0, 1)


def make_valid_cloud(
    xyz: NDArray[np.float32],
    scale: NDArray[np.float32],
    rotation: NDArray[np.float32],
    opacity: NDArray[np.float32],
    sh: NDArray[np.float32],
) -> SplatCloud:
    """Make a cloud from values that were read from a file. The quaternions need not be normalised.

    A splat is left out if one of its values is NaN or infinite or exceeds :data:`LARGEST` in absolute value, if a scale
    is below :data:`SMALLEST_SCALE`, or if its quaternion is 0. Opacities are clamped to [0, 1]. The arguments have the
    shapes of the fields of :class:`SplatCloud`.
    """
    length = np.linalg.norm(rotation.astype(np.float64), axis=1, keepdims=True)
    values = np.concatenate(
        [xyz, scale, rotation, opacity[:, None], sh.reshape(len(xyz), sh.shape[1] * sh.shape[2])], axis=1
    )
    kept = (np.abs(values) <= LARGEST).all(axis=1) & (scale >= SMALLEST_SCALE).all(axis=1) & (length[:, 0] > 1e-6)
    return SplatCloud(
        xyz[kept],
        scale[kept],
        (rotation[kept] / length[kept]).astype(np.float32),
        np.clip(opacity[kept], 0, 1),
        np.ascontiguousarray(sh[kept]),
    )


def merge_clouds(clouds: Sequence[SplatCloud]) -> SplatCloud:
    """Return all splats of one or more clouds whose spherical harmonics have the same degree."""
    names = ("xyz", "scale", "rotation", "opacity", "sh")
    return SplatCloud(*(np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in names))


def rotate_cloud(cloud: SplatCloud, rotation: NDArray[np.float64]) -> SplatCloud:
    """Rotate a cloud about the origin by the matrix R = ``rotation``.

    Args:
        rotation: (3, 3) matrix R. A point x moves to R @ x. In the direction R @ d, the rotated splat has the colour
            that the original splat has in the direction d.
    """
    turned = _multiply(_quaternion(rotation), cloud.rotation)
    harmonics = harmonics_rotation(rotation)[: cloud.sh.shape[-1], : cloud.sh.shape[-1]]
    return SplatCloud(
        np.asarray(cloud.xyz @ rotation.T, np.float32),
        cloud.scale,
        turned,
        cloud.opacity,
        np.asarray(cloud.sh @ harmonics.T, np.float32),
    )


def _quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def _multiply(left: NDArray[np.float64], right: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the products (N, 4) of one quaternion with N quaternions, all (w, x, y, z)."""
    w, x, y, z = left
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(right @ matrix.T, np.float32)
