"""Real spherical harmonics of degree 3, the field's order and constants (PlenOctrees, 3DGS)."""

from __future__ import annotations

import torch
from torch import Tensor

SH_TERMS = 16


def sh_basis(directions: Tensor) -> Tensor:
    """Evaluate the 16 real spherical harmonics up to degree 3.

    Args:
        directions: (..., 3) unit vectors; they are not normalised here.

    Returns:
        (..., 16), differentiable in ``directions``. Orthonormal over the sphere.
    """
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack(
        [
            torch.full_like(x, 0.28209479177387814),
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
        dim=-1,
    )
