"""A similarity transform of a scene: scale, rotation and translation of its points and cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.rendering.ops.shade.harmonics import harmonics_rotation
from fourd.scene.scene import BakedFrame, SceneManifest, to_triple
from fourd.scene.styles.normals import decode_octahedral, encode_octahedral

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Similarity:
    """The transform ``x -> scale * rotation @ x + translation`` of world positions.

    Attributes:
        scale: factor of all lengths, above 0.
        rotation: (3, 3) rotation matrix.
        translation: (3,) in the units of the transformed world.
    """

    scale: float
    rotation: Array
    translation: Array

    @classmethod
    def identity(cls) -> Similarity:
        """Return the transform that changes nothing."""
        return cls(1.0, np.eye(3), np.zeros(3))

    def then(self, other: Similarity) -> Similarity:
        """Return the transform that applies this one first and ``other`` second."""
        return Similarity(
            other.scale * self.scale,
            other.rotation @ self.rotation,
            other.scale * other.rotation @ self.translation + other.translation,
        )

    def points(self, xyz: NDArray[np.floating]) -> Array:
        """Transform positions (N, 3)."""
        return np.asarray(self.scale * xyz.astype(np.float64) @ self.rotation.T + self.translation)

    def camera(self, camera: Camera) -> Camera:
        """Return the camera that sees the transformed scene as ``camera`` sees the scene."""
        rotation = camera.rotation @ self.rotation.T
        translation = self.scale * camera.translation - rotation @ self.translation
        return Camera(camera.intrinsics, rotation, translation, camera.width, camera.height, camera.distortion)

    def frame(self, frame: BakedFrame) -> BakedFrame:
        """Transform the points of a frame, with their radii, spherical harmonics and normals.

        Raises UserError if float16 cannot store the scaled radii.
        """
        radius = frame.radius.astype(np.float32) * np.float32(self.scale)
        with np.errstate(over="ignore"):
            stored = radius.astype(np.float16)
        if len(radius) and (not np.isfinite(stored).all() or np.any((stored == 0) & (radius > 0))):
            raise UserError(
                f"--scale: expected radii from 6e-8 to 65504 world units, got {radius.min():g} to {radius.max():g}; "
                "choose another scale"
            )
        sh = np.einsum("nck,jk->ncj", frame.sh.astype(np.float32), harmonics_rotation(self.rotation))
        normals = frame.normals
        if normals is not None:
            normals = encode_octahedral((decode_octahedral(normals) @ self.rotation.T).astype(np.float32))
        return replace(
            frame,
            xyz=self.points(frame.xyz).astype(np.float32),
            radius=stored,
            sh=sh.astype(np.float16),
            normals=normals,
        )

    def manifest(self, manifest: SceneManifest) -> SceneManifest:
        """Transform the cameras and the lengths of a manifest. The bounds become the box around the transformed box."""
        corners = np.stack(np.meshgrid(*zip(*manifest.bounds, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
        moved, unit = self.points(corners), manifest.metres_per_unit
        return replace(
            manifest,
            source_cameras=tuple(self.camera(camera) for camera in manifest.source_cameras),
            other_cameras=tuple(self.camera(camera) for camera in manifest.other_cameras),
            focus=to_triple(self.points(np.array([manifest.focus]))[0]),
            bounds=(to_triple(moved.min(axis=0)), to_triple(moved.max(axis=0))),
            near=manifest.near * self.scale,
            metres_per_unit=None if unit is None else unit / self.scale,
        )
