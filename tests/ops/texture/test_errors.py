"""Messages for invalid arguments of texture lookups."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fourd.rendering.ops.loading import load_native
from fourd.rendering.triangles import texture, texture_construct_mip

TEX = torch.zeros(1, 8, 8, 3)
UV = torch.zeros(2, 4, 5, 2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tex": TEX[0]}, r"tex: expected shape \(B, H, W, C\), got \(8, 8, 3\)"),
        ({"tex": TEX[:, :0]}, r"tex: expected sides from 1 to 32768 texels, got \(1, 0, 8, 3\)"),
        ({"tex": TEX[:0]}, "tex: expected sides"),
        ({"tex": torch.zeros(1, 1, 2**15 + 1, 1)}, "tex: expected sides from 1 to 32768"),
        ({"tex": TEX[..., :0]}, "tex: expected 1 to 4096 channels, got 0"),
        ({"tex": TEX.expand(3, 8, 8, 3)}, "tex: expected 1 or 2 textures, one for each picture of uv, got 3"),
        ({"uv": UV[..., :1]}, r"uv: expected shape \(B, H, W, 2\), got \(2, 4, 5, 1\)"),
        ({"uv_da": torch.zeros(2, 4, 5, 6)}, r"uv_da: expected shape \(2, 4, 5, 4\), got \(2, 4, 5, 6\)"),
        ({"mip_level_bias": torch.zeros(2, 4, 5, 1)}, r"mip_level_bias: expected shape \(2, 4, 5\), got"),
        ({"filter_mode": "bilinear"}, "filter_mode: expected 'auto', .* or 'linear-mipmap-linear', got 'bilinear'"),
        ({"boundary_mode": "mirror"}, "boundary_mode: expected 'wrap', 'clamp', 'zero' or 'cube', got 'mirror'"),
        ({"boundary_mode": "cube"}, r"tex: expected shape \(B, 6, N, N, C\), got \(1, 8, 8, 3\)"),
        ({"filter_mode": "linear-mipmap-linear"}, "uv_da: expected uv_da or mip_level_bias for filter_mode"),
        ({"max_mip_level": -1}, "max_mip_level: expected 0 or more, got -1"),
        ({"backend": "gpu"}, "backend: expected 'auto', 'reference', 'cpu' or 'cuda', got 'gpu'"),
        ({"threads": -1}, "threads: expected 0"),
    ],
)
def test_invalid_values_are_named(arguments: dict[str, object], message: str) -> None:
    """Catches arguments of wrong shape that reach a kernel, which would read past the end of an array."""
    with pytest.raises(ValueError, match=message):
        texture(**{"tex": TEX, "uv": UV, **arguments})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tex": [[0.0]]}, "tex: expected a torch.Tensor, got list"),
        ({"tex": TEX.double()}, "tex: expected dtype float32, got float64"),
        ({"uv": UV.double()}, "uv: expected dtype float32, got float64"),
        ({"max_mip_level": 1.5}, "max_mip_level: expected None or an integer, got 1.5"),
    ],
)
def test_invalid_types_are_named(arguments: dict[str, object], message: str) -> None:
    """Catches arguments of another type that are converted without an error."""
    with pytest.raises(TypeError, match=message):
        texture(**{"tex": TEX, "uv": UV, **arguments})  # type: ignore[arg-type]


def test_invalid_mips_are_named() -> None:
    """Catches mip levels of another texture, which a kernel would read past their end."""
    da = torch.zeros(2, 4, 5, 4)
    with pytest.raises(
        ValueError, match=r"mip: expected the levels of a texture of shape \(1, 8, 8, 3\), got those of"
    ):
        texture(TEX, UV, da, mip=texture_construct_mip(torch.zeros(1, 4, 4, 3)))
    with pytest.raises(ValueError, match=r"mip\[0\]: expected shape \(1, 4, 4, 3\), got \(1, 8, 8, 3\)"):
        texture(TEX, UV, da, mip=[TEX])
    with pytest.raises(ValueError, match="mip: expected at most 3 levels for 8 x 8 texels, got 4"):
        texture(TEX, UV, da, mip=[torch.zeros(1, size, size, 3) for size in (4, 2, 1, 1)])
    with pytest.raises(TypeError, match="mip: expected None, a Mip or a list of tensors, got Tensor"):
        texture(TEX, UV, da, mip=TEX)  # type: ignore[arg-type]


def test_faces_must_be_square() -> None:
    """Catches faces whose sides differ, which have no common edges."""
    with pytest.raises(ValueError, match=r"tex: expected square faces \(B, 6, N, N, C\), got \(1, 6, 4, 8, 3\)"):
        texture_construct_mip(torch.zeros(1, 6, 4, 8, 3), cube_mode=True)


def test_the_binding_refuses_chains_with_odd_sides() -> None:
    """Catches mip levels that are written past the end of their array, if a caller does not use fourd.rendering."""
    fine, coarse = np.zeros((1, 1, 2, 3, 2), np.float32), np.zeros((1, 1, 1, 1, 2), np.float32)
    with pytest.raises(ValueError, match="expected even sides in every level before the last"):
        load_native().build_mips(fine, 1, "baseline", [coarse])
