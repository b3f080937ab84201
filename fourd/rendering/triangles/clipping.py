"""Clip coordinates for fourd's cameras: :func:`clip_matrix`."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from fourd.base.cameras import Camera


def clip_matrix(camera: Camera, near: float, far: float) -> Tensor:
    """Return the (4, 4) float32 matrix that maps homogeneous world coordinates to clip coordinates.

    The clip coordinates of points are ``pos = xyz_homogeneous @ clip_matrix(camera, near, far).T``. With them,
    :func:`fourd.rendering.triangles.rasterize` at the camera's resolution shows each point in the same row and column
    as the camera's image. Row 0 is at the top. w is the camera depth, and z/w is -1 at the depth ``near`` and 1 at the
    depth ``far``.

    Args:
        camera: pinhole camera without lens distortion.
        near: camera depth, in world units, of the nearest visible surfaces; 0 < near < far.
        far: camera depth, in world units, of the farthest visible surfaces.

    Raises:
        TypeError: if ``camera`` is not a camera.
        ValueError: if the camera has lens distortion, or the depths are out of range.
    """
    if not isinstance(camera, Camera):
        raise TypeError(f"camera: expected a fourd.Camera, got {type(camera).__name__}")
    if camera.distortion is not None:
        raise ValueError("camera: expected a pinhole camera without lens distortion; undistort the images first")
    if not (0 < near < far and math.isfinite(far)):
        raise ValueError(f"near, far: expected 0 < near < far, both finite, got {near} and {far}")
    intrinsics = torch.tensor(camera.intrinsics)
    to_device = torch.tensor([[2 / camera.width, 0, -1], [0, 2 / camera.height, -1], [0, 0, 1]], dtype=torch.float64)
    projection = torch.zeros(4, 4, dtype=torch.float64)
    projection[[0, 1, 3], :3] = to_device @ intrinsics
    projection[2, 2] = (far + near) / (far - near)
    projection[2, 3] = -2 * far * near / (far - near)
    extrinsics = torch.eye(4, dtype=torch.float64)
    extrinsics[:3, :3] = torch.tensor(camera.rotation)
    extrinsics[:3, 3] = torch.tensor(camera.translation)
    return (projection @ extrinsics).float()
