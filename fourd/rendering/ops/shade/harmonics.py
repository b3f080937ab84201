"""Real spherical harmonics up to degree 3, in the order and with the constants of PlenOctrees and 3DGS.

``csrc/shade/maths.h`` contains the same functions for the kernels.
"""

from __future__ import annotations

from typing import Any

SH_TERMS = 16
SH_CONSTANT = 0.28209479177387814
"""Value of spherical harmonic 0, which is the same for all directions."""


def directional_terms(x: Any, y: Any, z: Any) -> list[Any]:
    """Evaluate spherical harmonics 1 to 15 at unit vectors (x, y, z).

    Args:
        x, y, z: NumPy arrays or torch tensors of equal shape.

    Returns:
        15 arrays with the shape of ``x``. Together with spherical harmonic 0 (:data:`SH_CONSTANT`), they are
        orthonormal on the sphere.
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
