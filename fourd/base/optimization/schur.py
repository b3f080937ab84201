"""Normal equations with many small blocks of unknowns, which a Schur complement eliminates (Triggs et al., Bundle
Adjustment - a Modern Synthesis, 2000, sec. 6.1).

The blocks are coupled only with the remaining unknowns, not with each other. Examples are the points of a bundle
adjustment and the poses of a calibration board. The computing time grows linearly with the number of blocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Coupling(Protocol):
    """A matrix (P, N * k) between P kept unknowns and N blocks of k eliminated unknowns."""

    def multiply_blocks(self, blocks: Array) -> Self:
        """Return the product with the block-diagonal matrix of ``blocks`` (N, k, k)."""

    def multiply_transposed(self, other: Self) -> Array:
        """Return the product (P, P) with the transpose of ``other``."""

    def to_kept(self, eliminated: Array) -> Array:
        """Return the product (P,) with a vector (N, k) of eliminated unknowns."""

    def to_eliminated(self, kept: Array) -> Array:
        """Return the product (N, k) of the transpose with a vector (P,) of kept unknowns."""


CouplingType = TypeVar("CouplingType", bound=Coupling)


@dataclass(frozen=True, eq=False)
class DenseCoupling:
    """A coupling in which each block of unknowns is coupled with most of the kept unknowns.

    Attributes:
        values: (N, P, k) the matrix of each block.
    """

    values: Array

    def multiply_blocks(self, blocks: Array) -> DenseCoupling:
        return DenseCoupling(self.values @ blocks)

    def multiply_transposed(self, other: DenseCoupling) -> Array:
        size = self.values.shape[1]
        left, right = (np.swapaxes(one.values, 0, 1).reshape(size, -1) for one in (self, other))
        return np.asarray(left @ right.T)

    def to_kept(self, eliminated: Array) -> Array:
        return np.asarray(np.einsum("fij,fj->i", self.values, eliminated))

    def to_eliminated(self, kept: Array) -> Array:
        return np.asarray(np.einsum("fij,i->fj", self.values, kept))


@dataclass(frozen=True, eq=False)
class SparseCoupling:
    """A coupling in which each block of unknowns is coupled with few groups of kept unknowns.

    Attributes:
        matrix: (P, N * k) matrix with blocks of the shape (group of kept unknowns, k).
    """

    matrix: bsr_array

    @classmethod
    def from_blocks(cls, values: Array, rows: Indices, columns: Indices, shape: tuple[int, int]) -> SparseCoupling:
        """Place the blocks ``values`` (M, p, k) at the given block ``rows`` (M,) and ``columns`` (M,) of a matrix with
        ``shape`` blocks."""
        order = np.lexsort((columns, rows))
        starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=shape[0]))])
        size = (shape[0] * values.shape[1], shape[1] * values.shape[2])
        return cls(bsr_array((values[order], columns[order], starts), shape=size))

    def multiply_blocks(self, blocks: Array) -> SparseCoupling:
        own = self.matrix
        return SparseCoupling(bsr_array((own.data @ blocks[own.indices], own.indices, own.indptr), shape=own.shape))

    def multiply_transposed(self, other: SparseCoupling) -> Array:
        return np.asarray((self.matrix @ other.matrix.T).toarray())

    def to_kept(self, eliminated: Array) -> Array:
        return np.asarray(self.matrix @ eliminated.ravel())

    def to_eliminated(self, kept: Array) -> Array:
        return np.asarray(self.matrix.T @ kept).reshape(-1, self.matrix.blocksize[1])


@dataclass(frozen=True, eq=False)
class NormalEquations(Generic[CouplingType]):
    """Normal equations of P kept unknowns and N blocks of k unknowns.

    Attributes:
        kept: (P, P) matrix of the kept unknowns.
        blocks: (N, k, k) matrices of the blocks.
        coupling: the matrix between both.
        rhs_kept: (P,) right-hand side.
        rhs_blocks: (N, k) right-hand side.
        ridge: number that is added to the diagonals of the damped blocks, so that they are not singular.
    """

    kept: Array
    blocks: Array
    coupling: CouplingType
    rhs_kept: Array
    rhs_blocks: Array
    ridge: float = 0.0

    def solve(self, damping: float) -> tuple[Array, Array]:
        """Solve the damped normal equations, whose diagonals are multiplied by 1 + ``damping``. Returns the kept
        unknowns (P,) and those of the blocks (N, k).

        Raises:
            numpy.linalg.LinAlgError: if the equations are singular.
        """
        inverse = self._inverse_blocks(damping)
        reduced, eliminated = self._reduce(damping, inverse)
        rhs = self.rhs_kept - eliminated.to_kept(self.rhs_blocks)
        kept = np.asarray(np.linalg.solve(reduced, rhs), np.float64)
        rest = self.rhs_blocks - self.coupling.to_eliminated(kept)
        return kept, np.einsum("fij,fj->fi", inverse, rest)

    def reduce(self, damping: float) -> tuple[Array, CouplingType]:
        """Return the matrix (P, P) of the reduced normal equations, and the product of the coupling with the inverse
        blocks."""
        return self._reduce(damping, self._inverse_blocks(damping))

    def predicted_decrease(self, kept: Array, blocks: Array) -> float:
        """Return the scalar product of a step and the right-hand side. It is a lower bound on the amount by which the
        step decreases the quadratic model of the cost."""
        return float(self.rhs_kept @ kept + np.sum(self.rhs_blocks * blocks))

    def _inverse_blocks(self, damping: float) -> Array:
        damped = _damped(self.blocks, damping) + self.ridge * np.eye(self.blocks.shape[-1])
        return np.asarray(np.linalg.inv(damped), np.float64)

    def _reduce(self, damping: float, inverse: Array) -> tuple[Array, CouplingType]:
        eliminated = self.coupling.multiply_blocks(inverse)
        return _damped(self.kept, damping) - eliminated.multiply_transposed(self.coupling), eliminated


def _damped(matrices: Array, damping: float) -> Array:
    return matrices * (1 + damping * np.eye(matrices.shape[-1]))
