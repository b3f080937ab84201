"""Renders textured meshes, to compare them with recorded images and to make figures."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.reconstruction.carving.silhouette import sample
from fourd.reconstruction.meshes.texturing.texture import TexturedMesh
from fourd.reconstruction.meshes.views import clip_positions
from fourd.rendering.ops.meshes.ids import decode_ids
from fourd.rendering.triangles import rasterize

SAMPLES = 3
"""Number of samples per pixel along each axis."""


@dataclass(frozen=True, eq=False)
class MeshImage:
    """A rendered image.

    Attributes:
        rgb: (H, W, 3) float32 colours in [0, 1], with a black background.
        alpha: (H, W) float32 fraction of each pixel that the mesh covers, in [0, 1].
    """

    rgb: NDArray[np.float32]
    alpha: NDArray[np.float32]


def render_mesh(mesh: TexturedMesh, camera: Camera, samples: int = SAMPLES) -> MeshImage:
    """Render a textured mesh without lighting.

    Each pixel is the mean of ``samples`` x ``samples`` bilinear samples of the texture. Both sides of triangles are
    visible.

    Args:
        mesh: the mesh.
        camera: pinhole camera.
        samples: number of samples per pixel along each axis, at least 1.
    """
    fine = camera.resize(camera.width * samples, camera.height * samples)
    clip = clip_positions(torch.from_numpy(mesh.xyz), fine)
    triangles = torch.from_numpy(mesh.triangles)
    rast, _ = rasterize(clip[None].contiguous(), triangles, (fine.height, fine.width), grad_db=False)
    index = decode_ids(rast[0, ..., 3]).numpy()
    seen = index >= 0
    u, v = rast[0, ..., 0].numpy()[seen][:, None], rast[0, ..., 1].numpy()[seen][:, None]
    a, b, c = (mesh.uv[mesh.triangles[index[seen], corner]] for corner in range(3))
    x, y = np.ascontiguousarray((u * a + v * b + (1 - u - v) * c).T) * np.float32(len(mesh.texture))
    rgb = np.zeros((fine.height, fine.width, 3), np.float32)
    rgb[seen] = sample(mesh.texture, x, y, cv2.INTER_LINEAR).astype(np.float32) / 255
    return MeshImage(_mean(rgb, samples), _mean(seen.astype(np.float32), samples))


def silhouette_iou(alpha: NDArray[np.float32], matte: NDArray[np.uint8]) -> float:
    """Return the intersection over union of a rendered silhouette and a matte (H, W), both thresholded at one half. The
    result is 1 if both are empty."""
    shown, wanted = alpha >= 0.5, matte >= 128
    union = np.count_nonzero(shown | wanted)
    return np.count_nonzero(shown & wanted) / union if union else 1.0


def _mean(values: NDArray[np.float32], samples: int) -> NDArray[np.float32]:
    """Return the mean over each block of ``samples`` x ``samples`` pixels."""
    height, width = values.shape[0] // samples, values.shape[1] // samples
    blocks = values.reshape(height, samples, width, samples, *values.shape[2:])
    return np.asarray(blocks.mean(axis=(1, 3)), np.float32)
