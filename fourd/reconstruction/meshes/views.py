"""The views of one frame, cropped to the subject, and depth images of a mesh in these views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.meshes.ids import decode_ids
from fourd.rendering.triangles import clip_matrix, rasterize

MARGIN_PX = 16
"""Margin in pixels between the matte's bounding box and the border of the crop."""

NEAR_SHARE = 0.05
"""Depth of the near plane, as a fraction of the nearest vertex's depth. The far plane is at twice the depth of the
farthest vertex."""


@dataclass(frozen=True, eq=False)
class MeshView:
    """One view of a frame, cropped to the subject.

    Attributes:
        camera: pinhole camera of the crop.
        rgb: (H, W, 3) float32 image in [0, 1].
        matte: (H, W) float32 matte in [0, 1].
    """

    camera: Camera
    rgb: NDArray[np.float32]
    matte: NDArray[np.float32]

    @staticmethod
    def cropped(
        image: NDArray[np.uint8], matte: NDArray[np.uint8], camera: Camera, margin: int = MARGIN_PX
    ) -> MeshView:
        """Crop an undistorted image (H, W, 3) and its matte (H, W) to the subject.

        If the matte is empty, the crop is the whole image. Mesh fitting compares the rendered mesh with the matte only
        inside the crop, so with this crop, the loss penalises the mesh wherever it projects into the image.

        Raises:
            ValueError: if the sizes of image, matte and camera differ.
        """
        if image.shape[:2] != matte.shape or matte.shape != (camera.height, camera.width):
            raise ValueError(
                f"matte: expected the camera's shape {(camera.height, camera.width)}, got the matte {matte.shape} "
                f"and the image {image.shape[:2]}"
            )
        left, top, width, height = cv2.boundingRect((matte >= 8).view(np.uint8))
        if width == 0:
            left, top, width, height = 0, 0, camera.width, camera.height
        right, bottom = min(camera.width, left + width + margin), min(camera.height, top + height + margin)
        left, top = max(0, left - margin), max(0, top - margin)
        part = np.s_[top:bottom, left:right]
        return MeshView(
            camera.crop(left, top, right - left, bottom - top),
            image[part].astype(np.float32) / np.float32(255),
            matte[part].astype(np.float32) / np.float32(255),
        )


def clip_positions(xyz: Tensor, camera: Camera) -> Tensor:
    """Return the clip-space positions (N, 4) of world points (N, 3), differentiable.

    All points in front of the camera lie between the near plane and the far plane.
    """
    depth = xyz.detach() @ torch.tensor(camera.rotation[2].tolist(), dtype=xyz.dtype) + float(camera.translation[2])
    in_front = depth[depth > 0]
    far = 2 * float(in_front.max()) if len(in_front) else 1.0
    near = NEAR_SHARE * float(in_front.min()) if len(in_front) else 0.1
    matrix = clip_matrix(camera, max(near, 1e-5 * far), far).to(xyz.dtype)
    return torch.nn.functional.pad(xyz, (0, 1), value=1.0) @ matrix.T


def depth_image(xyz: Tensor, triangles: Tensor, camera: Camera) -> NDArray[np.float32]:
    """Render the depth (H, W) float32 of a mesh, in world units. It is infinite where the camera sees no triangle.

    Args:
        xyz: (N, 3) float32 vertices.
        triangles: (M, 3) integer vertex indices.
        camera: pinhole camera.
    """
    with torch.no_grad():
        clip = clip_positions(xyz, camera)
        rast, _ = rasterize(clip[None].contiguous(), triangles.int(), (camera.height, camera.width), grad_db=False)
        index = decode_ids(rast[0, ..., 3]).long()
        corners = clip[:, 3][triangles.long()][index.clamp(min=0)]
        u, v = rast[0, ..., 0], rast[0, ..., 1]
        depth = u * corners[..., 0] + v * corners[..., 1] + (1 - u - v) * corners[..., 2]
        depth[index < 0] = torch.inf
    return depth.numpy()


def mesh_views(
    images: Sequence[NDArray[np.uint8]], mattes: Sequence[NDArray[np.uint8]], cameras: Sequence[Camera]
) -> list[MeshView]:
    """Crop all views of a frame. ``images``, ``mattes`` and ``cameras`` have the same order."""
    return [MeshView.cropped(*view) for view in zip(images, mattes, cameras, strict=True)]
