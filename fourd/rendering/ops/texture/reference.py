"""Filtered texture lookup in plain torch."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from fourd.rendering.ops.texture.cubes import face_axes, face_of, pad_cube, project

MIN_SQUARE = 1e-36
"""A pixel's footprint in the texture is treated as a point if the square of its longer axis is below this number of
squared texels."""


def build_mips_reference(tex: Tensor, level_count: int) -> list[Tensor]:
    """Compute levels 1 to ``level_count`` - 1 of a texture (..., H, W, C). The levels are differentiable."""
    levels = [tex]
    for _ in range(1, level_count):
        fine = levels[-1]
        if fine.shape[-3] > 1:
            fine = 0.5 * (fine[..., 0::2, :, :] + fine[..., 1::2, :, :])
        if fine.shape[-2] > 1:
            fine = 0.5 * (fine[..., 0::2, :] + fine[..., 1::2, :])
        levels.append(fine)
    return levels[1:]


def sample_texture_reference(
    levels: Sequence[Tensor],
    uv: Tensor,
    uv_da: Tensor | None,
    bias: Tensor | None,
    filter_mode: str,
    boundary_mode: str,
) -> Tensor:
    """Compute the result of :func:`fourd.rendering.ops.texture.op.sample_texture`, on any device, in float32 or
    float64.

    ``levels`` are level 0 and all mip levels. The result is differentiable in all tensors.
    """
    is_cube = boundary_mode == "cube"
    faces = [level if is_cube else level[:, None] for level in levels]
    is_used = uv.isfinite().all(-1, keepdim=True)
    if is_cube:
        is_used = is_used & (uv != 0).any(-1, keepdim=True)
    # Invalid positions are replaced before any arithmetic, because they would make gradients NaN.
    position = torch.where(is_used, uv, torch.ones_like(uv))
    face = face_of(position) if is_cube else torch.zeros(uv.shape[:-1], dtype=torch.long, device=uv.device)
    st = project(position, face) if is_cube else position
    if "mipmap" not in filter_mode:
        out = _sample_level(faces[0], face, st, filter_mode == "nearest", boundary_mode)
        return torch.where(is_used, out, torch.zeros_like(out))
    level = _mip_level(faces[0], position, face, uv_da, bias, len(levels))
    samples = [_sample_level(one, face, st, False, boundary_mode) for one in faces]
    index = torch.arange(len(levels), device=uv.device, dtype=uv.dtype)
    if filter_mode == "linear-mipmap-nearest":
        weights = (level.detach().floor()[..., None] == index).to(uv.dtype)
    else:
        weights = (1 - (level[..., None] - index).abs()).clamp(min=0)
    out = torch.stack([weights[..., k, None] * sample for k, sample in enumerate(samples)]).sum(0)
    return torch.where(is_used, out, torch.zeros_like(out))


def _mip_level(
    base: Tensor, position: Tensor, face: Tensor, uv_da: Tensor | None, bias: Tensor | None, count: int
) -> Tensor:
    """Return the mip level (B, H', W') of each output pixel. It is the base-2 logarithm of the longer axis of the
    pixel's footprint in texels (0 if ``uv_da`` is None) plus ``bias``, clamped to [0, count - 1]."""
    level = torch.zeros(position.shape[:-1], dtype=position.dtype, device=position.device)
    if uv_da is not None:
        derivatives = uv_da.unflatten(-1, (-1, 2))  # (B, H', W', coordinates, 2)
        if base.shape[1] == 6:
            derivatives = _projected(position, face, derivatives)
        size = torch.tensor([base.shape[3], base.shape[2]], dtype=position.dtype, device=position.device)
        level = _log2_of_longer_axis((derivatives * size[:, None]).clamp(-1e9, 1e9))
    if bias is not None:
        level = level + bias
    level = torch.where(level.isnan(), torch.zeros_like(level), level)
    return level.clamp(0, count - 1)


def _projected(direction: Tensor, face: Tensor, derivatives: Tensor) -> Tensor:
    """Return the derivatives of the position on a face, a matrix 2 x 2 in the last two axes of the result. The last
    two axes of ``derivatives`` contain the derivatives of the direction, a matrix 3 x 2."""
    axes = face_axes(direction)[face]
    a, b, m = (axes @ direction[..., None]).unbind(-2)
    a_d, b_d, m_d = (axes @ derivatives).unbind(-2)
    return torch.stack([0.5 * (a_d - a / m * m_d) / m, 0.5 * (b_d - b / m * m_d) / m], dim=-2)


def _log2_of_longer_axis(derivatives: Tensor) -> Tensor:
    by_x, by_y = derivatives.unbind(-1)
    a, b, c = (by_x * by_x).sum(-1), (by_y * by_y).sum(-1), (by_x * by_y).sum(-1)
    inside = 0.25 * (a - b) ** 2 + c * c
    is_circle = inside == 0
    root = torch.where(is_circle, torch.zeros_like(inside), torch.where(is_circle, 1, inside).sqrt())
    square = 0.5 * (a + b) + root
    is_point = square < MIN_SQUARE
    level = 0.5 * torch.where(is_point, 1, square).log2()
    return torch.where(is_point, torch.full_like(level, -1e30), level)


def _sample_level(faces: Tensor, face: Tensor, st: Tensor, is_nearest: bool, boundary_mode: str) -> Tensor:
    """Sample one level (items, faces, H, W, C) at all positions (B, H', W', 2). Return (B, H', W', C)."""
    height, width = faces.shape[2:4]
    s, t = st.unbind(-1)
    if boundary_mode == "wrap":
        s, t = s - s.detach().floor(), t - t.detach().floor()
    item = torch.arange(st.shape[0], device=st.device).view(-1, 1, 1) % faces.shape[0]
    if is_nearest:
        column, row = (s * width).detach().floor(), (t * height).detach().floor()
        found = faces[item, face, row.clamp(0, height - 1).long(), column.clamp(0, width - 1).long()]
        is_inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        is_black = ~is_inside & (boundary_mode == "zero")
        return torch.where(is_black[..., None], torch.zeros_like(found), found)
    padded = _pad(faces, boundary_mode)
    low, high = (0, -1) if boundary_mode == "clamp" else (-1, 0)
    x, y = (s * width - 0.5).clamp(low, width + high), (t * height - 0.5).clamp(low, height + high)
    left, top = x.detach().floor().clamp(-1, width - 1), y.detach().floor().clamp(-1, height - 1)
    column, row = (left + 1).long(), (top + 1).long()
    across, down = (x - left)[..., None], (y - top)[..., None]
    upper = (1 - across) * padded[item, face, row, column] + across * padded[item, face, row, column + 1]
    lower = (1 - across) * padded[item, face, row + 1, column] + across * padded[item, face, row + 1, column + 1]
    return (1 - down) * upper + down * lower


def _pad(faces: Tensor, boundary_mode: str) -> Tensor:
    """Extend each image by one texel on each side, with values that the boundary mode defines."""
    if boundary_mode == "cube":
        return pad_cube(faces)
    if boundary_mode == "zero":
        return functional.pad(faces, (0, 0, 1, 1, 1, 1))
    if boundary_mode == "clamp":
        faces = torch.cat([faces[:, :, :1], faces, faces[:, :, -1:]], dim=2)
        return torch.cat([faces[:, :, :, :1], faces, faces[:, :, :, -1:]], dim=3)
    faces = torch.cat([faces[:, :, -1:], faces, faces[:, :, :1]], dim=2)
    return torch.cat([faces[:, :, :, -1:], faces, faces[:, :, :, :1]], dim=3)
