"""Real spherical harmonics of degree 3, with the order and constants of PlenOctrees and 3DGS.

The C++ side has the same table in ``csrc/shade/maths.h``.
"""

from __future__ import annotations

from typing import Any

SH_TERMS = 16
SH_CONSTANT = 0.28209479177387814
"""Term 0, the same in all directions."""


def directional_terms(x: Any, y: Any, z: Any) -> list[Any]:
    """Evaluate terms 1 to 15 at unit vectors (x, y, z).

    Args:
        x, y, z: NumPy arrays or torch tensors of one shape; they are not normalized here.

    Returns:
        15 arrays of that shape. With :data:`SH_CONSTANT` in front they are orthonormal over the sphere.
    """
    xx, yy, zz = x * x, y * y, z * z
    return [
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
    ]
