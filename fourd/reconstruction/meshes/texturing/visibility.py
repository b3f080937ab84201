"""Tests which surface points a camera sees, with rays from the surface to the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.rays import Bvh, occluded

Floats = NDArray[np.float32]

OFFSET_EDGES = 0.5
"""Distance between the surface and a ray's origin, along the normal, in units of the mesh's mean edge length. It
prevents small bumps around a point from hiding the point."""

CORNERS_PX = ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5))
"""Image positions of the four rays that are traced for each point, in pixels relative to the projected point: the
corners of a square of one pixel around it. One ray is not enough, because a bilinear sample also reads neighbouring
pixels, which must not show a surface in front of the point."""


@dataclass(frozen=True, eq=False)
class Occluder:
    """A mesh that hides points from cameras.

    Attributes:
        bvh: bounding volume hierarchy of the triangles.
        offset: distance between the surface and a ray's origin, in world units.
    """

    bvh: Bvh
    offset: float

    @staticmethod
    def of(xyz: Floats, triangles: NDArray[np.integer]) -> Occluder:
        """Build the bounding volume hierarchy of a mesh from its vertices ``xyz`` (N, 3) and its vertex indices
        ``triangles`` (M, 3). M may be 0."""
        edges = xyz[triangles[:, 1]] - xyz[triangles[:, 0]]
        mean = float(np.linalg.norm(edges, axis=1).mean()) if len(edges) else 0.0
        indices = torch.from_numpy(np.ascontiguousarray(triangles, np.int32))
        return Occluder(Bvh.build(torch.from_numpy(np.ascontiguousarray(xyz)), indices), OFFSET_EDGES * mean)

    def hides(self, xyz: Floats, normals: Floats, camera: Camera) -> NDArray[np.bool_]:
        """Return a mask (P,) that is true for points that the mesh hides from a camera.

        For each point, four rays to the camera are traced. In the image, they project to the corners of a square of
        one pixel around the projected point (see CORNERS_PX). The point counts as hidden if the mesh blocks at least
        one of these rays. The rays start in a plane that is parallel to the point's tangent plane and lies ``offset``
        outside the surface.

        Args:
            xyz: (P, 3) points on the mesh, in front of the camera.
            normals: (P, 3) outward unit normals. The surface must face the camera at each point.
            camera: pinhole camera.
        """
        centre, axes = camera.centre.astype(np.float32), camera.rotation.astype(np.float32)
        lifted = xyz + np.float32(self.offset) * normals
        depth = (lifted - centre) @ axes[2]
        hidden = np.zeros(len(xyz), np.bool_)
        for column, row in CORNERS_PX:
            tried = np.flatnonzero(~hidden)
            start, normal = lifted[tried], normals[tried]
            right, down = column / camera.intrinsics[0, 0], row / camera.intrinsics[1, 1]
            beside = start + depth[tried, None] * (np.float32(right) * axes[0] + np.float32(down) * axes[1])
            towards = beside - centre
            height = (towards * normal).sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                t = ((start - centre) * normal).sum(axis=1) / height
            # ``start`` is the point, moved outwards by ``offset``. The traced ray starts where the line from the camera
            # through a corner of the square (see CORNERS_PX) meets the plane through ``start``, at
            # ``centre + t * towards``.
            # If the camera sees the surface almost edge-on, the line is almost parallel to the plane and meets it far
            # away or not at all, so t is clamped to keep the ray's origin near the point. At t = 1, the ray's origin
            # has the same camera depth as ``start``.
            t = np.where(np.isfinite(t), t, 1).clip(0.5, 2).astype(np.float32)
            origins = centre + t[:, None] * towards
            rays = torch.from_numpy(origins), torch.from_numpy(centre - origins)
            hidden[tried] = occluded(self.bvh, *rays, t_max=1.0).numpy()
        return hidden
