"""A triangle mesh in memory."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

WHITE = 200
"""Grey value of meshes without colours."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh with colours per vertex, or with a texture.

    Attributes:
        xyz: (V, 3) float32 vertices in world units, all finite.
        triangles: (T, 3) int32 vertex indices.
        normals: (V, 3) float32 unit normals. If None is given, the mean normals of the adjacent triangles are used.
        rgb: (V, 3) uint8 sRGB colours, or None.
        uv: (V, 2) float32 positions in the texture, from 0 to 1 with v downwards, or None.
        texture: (S, S', 3) uint8 sRGB texture, or None. If a texture is given, ``rgb`` is ignored.
        up: (3,) up direction in world coordinates.

    Raises:
        ValueError: for an array of another shape, an index out of range, or a number that is not finite. The message
            has the form "expected ..., got ...".
    """

    xyz: NDArray[np.float32]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32] | None = None
    rgb: NDArray[np.uint8] | None = None
    uv: NDArray[np.float32] | None = None
    texture: NDArray[np.uint8] | None = None
    up: NDArray[np.float64] = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    def __post_init__(self) -> None:
        count = len(self.xyz)
        if count == 0 or len(self.triangles) == 0:
            raise ValueError("expected at least one triangle, got none")
        for name, array, columns in (
            ("positions", self.xyz, 3),
            ("normals", self.normals, 3),
            ("colours", self.rgb, 3),
            ("texture coordinates", self.uv, 2),
        ):
            if array is None:
                continue
            if array.shape != (count, columns):
                raise ValueError(f"expected {name} of shape {(count, columns)}, got {array.shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"expected finite {name}, got NaN or infinity")
        if self.triangles.min() < 0 or self.triangles.max() >= count:
            worst = max(int(self.triangles.max()), -int(self.triangles.min()))
            raise ValueError(f"expected vertex indices from 0 to {count - 1}, got {worst}")
        if (self.texture is None) != (self.uv is None):
            raise ValueError("expected a texture with texture coordinates, got only one of them")
        normals = self.normals
        object.__setattr__(self, "normals", _unit(_mean_normals(self) if normals is None else normals))


def _mean_normals(mesh: Mesh) -> NDArray[np.float32]:
    """Return the vertex normals: the mean normals of the adjacent triangles, weighted by area."""
    a, b, c = (mesh.xyz[mesh.triangles[:, corner]].astype(np.float64) for corner in range(3))
    faces = np.cross(b - a, c - a)
    total = np.zeros((len(mesh.xyz), 3))
    for corner in range(3):
        np.add.at(total, mesh.triangles[:, corner], faces)
    return total.astype(np.float32)


def _unit(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return (vectors / np.maximum(length, 1e-20)).astype(np.float32)
