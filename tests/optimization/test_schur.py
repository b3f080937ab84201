"""Normal equations with eliminated blocks, compared with the same equations as one dense matrix."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.base.optimization.schur import Coupling, DenseCoupling, NormalEquations, SparseCoupling

GROUPS, SIZE, BLOCKS, INNER = 4, 3, 6, 2
KEPT = GROUPS * SIZE


@pytest.mark.parametrize("kind", ["dense", "sparse"])
@pytest.mark.parametrize(("damping", "ridge"), [(0.0, 0.0), (0.3, 0.1)])
def test_the_solution_is_that_of_the_whole_system(
    kind: str, damping: float, ridge: float, rng: np.random.Generator
) -> None:
    """Catches blocks that are placed, transposed or damped wrongly."""
    jacobian = rng.normal(size=(80, KEPT + BLOCKS * INNER))
    whole, rhs = jacobian.T @ jacobian, rng.normal(size=KEPT + BLOCKS * INNER)
    inner = np.kron(np.eye(BLOCKS), np.ones((INNER, INNER)))
    whole[KEPT:, KEPT:] *= inner
    whole[:KEPT, KEPT:] *= 0.1
    whole[KEPT:, :KEPT] *= 0.1
    mixed = whole[:KEPT, KEPT:].reshape(KEPT, BLOCKS, INNER).swapaxes(0, 1)
    rows, columns = (some.ravel() for some in np.indices((GROUPS, BLOCKS)))
    order = rng.permutation(len(rows))
    parts = mixed.reshape(BLOCKS, GROUPS, SIZE, INNER)[columns, rows]
    coupling: Coupling = DenseCoupling(mixed)
    if kind == "sparse":
        coupling = SparseCoupling.from_blocks(parts[order], rows[order], columns[order], (GROUPS, BLOCKS))
    blocks = np.stack([whole[KEPT:, KEPT:][i : i + INNER, i : i + INNER] for i in range(0, BLOCKS * INNER, INNER)])
    equations = NormalEquations(
        whole[:KEPT, :KEPT], blocks, coupling, rhs[:KEPT], rhs[KEPT:].reshape(BLOCKS, INNER), ridge
    )
    found = np.concatenate([part.ravel() for part in equations.solve(damping)])
    diagonal = damping * np.diag(np.diag(whole)) + ridge * np.diag(np.arange(len(rhs)) >= KEPT)
    assert found == pytest.approx(np.linalg.solve(whole + diagonal, rhs), rel=1e-9)
    kept, rest = equations.solve(damping)
    assert equations.predicted_decrease(kept, rest) == pytest.approx(rhs @ found)
