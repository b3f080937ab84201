"""Checks the arguments of texture lookups."""

from __future__ import annotations

from typing import Literal, get_args

import torch
from torch import Tensor

from fourd.rendering.ops.meshes.checks import check_tensor

FilterMode = Literal["auto", "nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear"]
BoundaryMode = Literal["wrap", "clamp", "zero", "cube"]

MAX_SIDE = 2**15
MAX_CHANNELS = 2**12


def check_modes(filter_mode: str, boundary_mode: str) -> None:
    for name, value, choices in (
        ("filter_mode", filter_mode, get_args(FilterMode)),
        ("boundary_mode", boundary_mode, get_args(BoundaryMode)),
    ):
        if value not in choices:
            expected = ", ".join(repr(choice) for choice in choices[:-1])
            raise ValueError(f"{name}: expected {expected} or {choices[-1]!r}, got {value!r}")


def check_texture(tex: Tensor, is_cube: bool, backend: str) -> None:
    dtypes = (torch.float32, torch.float64) if backend == "reference" else (torch.float32,)
    check_tensor("tex", tex, ("B", 6, "N", "N", "C") if is_cube else ("B", "H", "W", "C"), dtypes=dtypes)
    height, width, channels = tex.shape[-3:]
    if is_cube and height != width:
        raise ValueError(f"tex: expected square faces (B, 6, N, N, C), got {tuple(tex.shape)}")
    if not (tex.shape[0] >= 1 and 1 <= height <= MAX_SIDE and 1 <= width <= MAX_SIDE):
        raise ValueError(f"tex: expected sides from 1 to {MAX_SIDE} texels, got {tuple(tex.shape)}")
    if height * width * (6 if is_cube else 1) >= 2**31:
        raise ValueError(f"tex: expected fewer than 2^31 texels, got {tuple(tex.shape)}")
    if not 1 <= channels <= MAX_CHANNELS:
        raise ValueError(f"tex: expected 1 to {MAX_CHANNELS} channels, got {channels}")


def check_pixels(tex: Tensor, uv: Tensor, uv_da: Tensor | None, bias: Tensor | None, is_cube: bool) -> None:
    coordinates = 3 if is_cube else 2
    like = ("tex", tex)
    check_tensor("uv", uv, ("B", "H", "W", coordinates), like=like)
    if tex.shape[0] not in (1, uv.shape[0]):
        raise ValueError(f"tex: expected 1 or {uv.shape[0]} textures, one for each picture of uv, got {tex.shape[0]}")
    if uv_da is not None:
        check_tensor("uv_da", uv_da, (*uv.shape[:3], 2 * coordinates), like=like)
    if bias is not None:
        check_tensor("mip_level_bias", bias, tuple(uv.shape[:3]), like=like)


def check_max_level(max_mip_level: int | None) -> None:
    if max_mip_level is None:
        return
    if isinstance(max_mip_level, bool) or not isinstance(max_mip_level, int):
        raise TypeError(f"max_mip_level: expected None or an integer, got {max_mip_level!r}")
    if max_mip_level < 0:
        raise ValueError(f"max_mip_level: expected 0 or more, got {max_mip_level}")


def count_levels(tex: Tensor, max_mip_level: int | None) -> int:
    """Return the number of mip levels built from ``tex``, including level 0, which is ``tex`` itself."""
    height, width = tex.shape[-3:-1]
    level = 0
    while max(height, width) > 1 and (max_mip_level is None or level < max_mip_level):
        if any(side > 1 and side % 2 == 1 for side in (height, width)):
            raise ValueError(
                f"tex: expected even sides in every level before the last, got {height} x {width} texels in level "
                f"{level}; resize tex, pass max_mip_level={level}, or pass mip levels as tensors"
            )
        height, width = max(height // 2, 1), max(width // 2, 1)
        level += 1
    return level + 1
