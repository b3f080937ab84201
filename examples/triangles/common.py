"""Helpers that the examples of this folder share: meshes, matrices, errors and image files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from scipy.spatial.transform import Rotation
from torch import Tensor


def cube() -> tuple[Tensor, Tensor]:
    """Return the corners (8, 3) of a cube with edges of length 2 around the origin, and its triangles (12, 3) int32.

    Triangles 2 * i and 2 * i + 1 form face i. All triangles are counter-clockwise seen from outside.
    """
    corners = torch.tensor([[x, y, z] for z in (-1.0, 1.0) for y in (-1.0, 1.0) for x in (-1.0, 1.0)])
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [triangle for a, b, c, d in faces for triangle in ((a, b, c), (a, c, d))]
    return corners, torch.tensor(triangles, dtype=torch.int32)


def face_colours() -> tuple[Tensor, Tensor]:
    """Return six colours (6, 3) in [0, 1] for the faces of :func:`cube`. Also return the index of the colour at each
    corner of each triangle, (12, 3) int32."""
    colours = torch.tensor(
        [[0.9, 0.2, 0.2], [0.2, 0.8, 0.3], [0.2, 0.3, 0.9], [0.9, 0.8, 0.2], [0.8, 0.3, 0.8], [0.3, 0.8, 0.8]]
    )
    return colours, (torch.arange(12, dtype=torch.int32) // 2)[:, None].repeat(1, 3)


def uv_sphere(rows: int, columns: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return a unit sphere with texture coordinates: vertices (V, 3), uv (V, 2) and triangles (T, 3) int32.

    The sphere is a grid of ``rows`` x ``columns`` quads over latitude and longitude. u is the longitude and v the
    colatitude, both in [0, 1]. The first and the last column of vertices have the same positions but different u.
    """
    v, u = torch.meshgrid(torch.linspace(0, 1, rows + 1), torch.linspace(0, 1, columns + 1), indexing="ij")
    longitude, colatitude = 2 * torch.pi * u, torch.pi * v
    xyz = torch.stack(
        [colatitude.sin() * longitude.cos(), colatitude.cos(), colatitude.sin() * longitude.sin()], dim=-1
    )
    index = torch.arange((rows + 1) * (columns + 1), dtype=torch.int32).reshape(rows + 1, columns + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    triangles = torch.cat(
        [torch.stack([a, b, c], dim=-1).reshape(-1, 3), torch.stack([a, c, d], dim=-1).reshape(-1, 3)]
    )
    return xyz.reshape(-1, 3), torch.stack([u, v], dim=-1).reshape(-1, 2), triangles


def perspective(half_width: float, near: float = 1.0, far: float = 50.0) -> Tensor:
    """Return a projection matrix (4, 4) to clip space for a camera at the origin that looks along -z.

    ``half_width`` is half of the width and height of the visible area at depth 1.
    """
    return torch.tensor(
        [
            [1 / half_width, 0, 0, 0],
            [0, 1 / half_width, 0, 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ]
    )


def rigid(R: Tensor, translation: tuple[float, float, float]) -> Tensor:
    """Return the matrices (..., 4, 4) that first apply the rotations ``R`` (..., 3, 3) and then the translation."""
    matrix = torch.zeros(*R.shape[:-2], 4, 4, dtype=R.dtype)
    matrix[..., :3, :3] = R
    matrix[..., :3, 3] = torch.tensor(translation, dtype=R.dtype)
    matrix[..., 3, 3] = 1
    return matrix


def random_rotations(count: int, rng: np.random.Generator) -> Tensor:
    """Return uniformly distributed rotations (count, 3, 3)."""
    return torch.from_numpy(Rotation.random(count, random_state=rng).as_matrix()).float()


def rotation_of_quaternion(quaternion: Tensor) -> Tensor:
    """Return the rotations (..., 3, 3) of quaternions (..., 4) in the order w, x, y, z. The quaternions can have any
    length above 0."""
    w, x, y, z = (quaternion / quaternion.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def angle_deg(R_a: Tensor, R_b: Tensor) -> Tensor:
    """Return the angles between rotations (..., 3, 3), in degrees."""
    trace = (R_a * R_b).sum(dim=(-1, -2))
    return ((trace - 1) / 2).clamp(-1, 1).acos().rad2deg()


def to_clip(matrix: Tensor, xyz: Tensor) -> Tensor:
    """Transform points (V, 3) by matrices (B, 4, 4) to clip space, (B, V, 4)."""
    homogeneous = torch.cat([xyz, torch.ones_like(xyz[:, :1])], dim=-1)
    return homogeneous @ matrix.transpose(-1, -2)


def psnr(image: Tensor, target: Tensor) -> float:
    """Return the peak signal-to-noise ratio in dB, for values in [0, 1]."""
    return float(-10 * (image - target).square().mean().clamp_min(1e-12).log10())


def save(images: list[Tensor], path: Path, *, scale: int = 1, bottom_up: bool = True) -> None:
    """Write images (H, W, 3) in [0, 1] side by side. Each pixel becomes a square of ``scale`` x ``scale`` pixels.

    If ``bottom_up``, row 0 is the bottom row, as in clip space.
    """
    row = torch.cat([image.detach().clamp(0, 1) for image in images], dim=1)
    row = row.flip(0) if bottom_up else row
    row = row.repeat_interleave(scale, dim=0).repeat_interleave(scale, dim=1)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((row * 255).round().byte().numpy()).save(path)
    print(f"wrote {path}")
