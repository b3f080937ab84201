"""Real spherical harmonics up to degree 3, in the order and with the constants of PlenOctrees and 3DGS."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.rendering.ops.shade.harmonics import SH_CONSTANT, SH_TERMS, directional_terms

__all__ = ["SH_TERMS", "sh_basis"]


def sh_basis(directions: Tensor) -> Tensor:
    """Evaluate the 16 real spherical harmonics up to degree 3 for given directions.

    Args:
        directions: (..., 3) unit vectors, which must already be normalised.

    Returns:
        (..., 16) values, differentiable in ``directions``. The functions are orthonormal over the sphere.
    """
    x, y, z = directions.unbind(-1)
    return torch.stack([torch.full_like(x, SH_CONSTANT), *directional_terms(x, y, z)], dim=-1)
