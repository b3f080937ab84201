"""Sorting of points in Morton order."""

from __future__ import annotations

import numpy as np

from fourd.rendering.ops.morton import morton_order


def test_neighbours_in_memory_are_neighbours_in_space(rng: np.random.Generator) -> None:
    """Catches an order whose bits are not interleaved. An order along one axis doubles the distances between
    consecutive points."""
    xyz = rng.uniform(-1, 1, (20_000, 3)).astype(np.float32)
    order = morton_order(xyz)
    assert np.array_equal(np.sort(order), np.arange(20_000))
    steps = np.linalg.norm(np.diff(xyz[order], axis=0), axis=1)
    spacing = 2 / 20_000 ** (1 / 3)
    assert np.median(steps) < 1.5 * spacing


def test_coincident_points_and_an_empty_cloud() -> None:
    """Catches a division by zero if the bounds of the points have a side of length 0."""
    assert np.array_equal(morton_order(np.ones((5, 3), np.float32)), np.arange(5))
    assert morton_order(np.zeros((0, 3), np.float32)).shape == (0,)
