"""Scenes for tests of antialiasing, and a rasterizer that tests every pixel against every triangle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from torch import Tensor

from fourd.rendering.ops.meshes.ids import encode_ids


@dataclass(frozen=True)
class Scene:
    """The arguments of ``antialias``."""

    color: Tensor
    rast: Tensor
    pos: Tensor
    tri: Tensor


def rasterize_brute_force(pos: Tensor, tri: Tensor, height: int, width: int) -> Tensor:
    """Rasterize the vertices ``pos`` (B, V, 4) in float64 without clipping. Returns u, v, z/w and the triangle id of
    each pixel, (B, H, W, 4) with the dtype of ``pos``.

    A pixel on an edge counts as inside. At equal depths, the pixel shows the triangle with the smaller id.
    """
    x = (2 * torch.arange(width, dtype=torch.float64) + 1) / width - 1
    y = (2 * torch.arange(height, dtype=torch.float64) + 1) / height - 1
    out = torch.zeros(len(pos), height, width, 4, dtype=torch.float64)
    for image, vertices in zip(out, pos.detach().double(), strict=True):
        corners = vertices[tri.long()]
        nearest = torch.full((height, width), torch.inf, dtype=torch.float64)
        best = torch.full((height, width), -1)
        for triangle, corner in enumerate(corners):
            inverse = torch.linalg.pinv(corner[:, [0, 1, 3]].T) if corner.isfinite().all() else torch.full((3, 3), 0.0)
            weights = inverse[:, 0] * x[None, :, None] + inverse[:, 1] * y[:, None, None] + inverse[:, 2]
            total = weights.sum(-1)
            weights = weights / total[..., None]
            depth = (weights * corner[:, 2]).sum(-1) / (weights * corner[:, 3]).sum(-1)
            # The tolerance 1e-12 is needed, because pinv rounds differently on different processors.
            inside = (weights >= -1e-12).all(-1) & (total > 0) & (depth.abs() <= 1) & (depth < nearest)
            nearest[inside], best[inside] = depth[inside], triangle
            image[inside] = torch.stack((weights[..., 0], weights[..., 1], depth, depth), -1)[inside]
        image[..., 3] = encode_ids(best).double()
        image[best < 0] = 0
    return out.to(pos.dtype)


def random_scene(
    rng: np.random.Generator,
    *,
    batch: int = 2,
    channels: int = 3,
    size: tuple[int, int] = (29, 34),
    intersecting: bool = True,
) -> Scene:
    """A sphere, a box and four single triangles, in perspective and with random colours. The surfaces intersect each
    other. If ``intersecting`` is False, the scene contains only the sphere."""
    sphere, box = trimesh.creation.icosphere(subdivisions=1, radius=0.7), trimesh.creation.box((0.8, 0.9, 1.0))
    points = np.concatenate((sphere.vertices - 0.3, box.vertices + 0.4, rng.uniform(-1.3, 1.3, (12, 3))))
    faces = np.concatenate((sphere.faces, box.faces + 42, np.arange(12).reshape(4, 3) + 50))
    if not intersecting:
        points, faces = points[:42], faces[:80]
    clip = []
    for _ in range(batch):
        rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        x, y, z = (points @ rotation.T).T
        w = z + 3
        clip.append(np.stack((1.7 * x, 1.7 * y, (w - 2.9) * 1.2, w), 1))
    pos = torch.from_numpy(np.stack(clip).astype(np.float32))
    tri = torch.from_numpy(rng.permutation(faces).astype(np.int32))
    color = torch.from_numpy(rng.random((batch, *size, channels), dtype=np.float32))
    return Scene(color, rasterize_brute_force(pos, tri, *size), pos, tri)


def rectangle(x0: float, y0: float, x1: float, y1: float, height: int, width: int, z: float = 0.0) -> Tensor:
    """The four corners (4, 4) in clip space of a rectangle whose sides are given in pixels."""
    xy = torch.tensor([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=torch.float64)
    ndc = xy * torch.tensor([2 / width, 2 / height], dtype=torch.float64) - 1
    rest = torch.tensor([z, 1.0], dtype=torch.float64)
    return torch.cat((ndc, rest.expand(4, 2)), 1)


RECTANGLE = torch.tensor([[0, 1, 2], [0, 2, 3]], dtype=torch.int32)
