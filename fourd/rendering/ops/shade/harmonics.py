"""Real spherical harmonics up to degree 3, in the order and with the constants of PlenOctrees and 3DGS.

``csrc/shade/maths.h`` contains the same functions for the kernels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def harmonics_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix (16, 16) that multiplies spherical-harmonics coefficients when the scene is rotated by R =
    ``rotation`` (3, 3). It mixes only coefficients of the same degree.

    The matrix solves a linear system: for each direction d, the colour of the rotated scene in the direction d must
    equal the colour of the original scene in the direction R.T @ d. The system is overdetermined but has an exact
    solution.
    """
    directions = np.random.default_rng(0).normal(size=(4 * SH_TERMS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    after, before = _basis(directions), _basis(directions @ rotation)
    solution = np.linalg.lstsq(after, before, rcond=None)[0]
    return np.asarray(np.where(np.abs(solution) < 1e-12, 0, solution))


def _basis(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    terms = directional_terms(*directions.T)
    return np.stack([np.full(len(directions), SH_CONSTANT), *terms], axis=1)
