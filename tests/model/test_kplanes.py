"""K-Planes compared with bilinear interpolation in NumPy, and the config options of K-Planes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.reconstruction.model.config import PlanesConfig
from fourd.reconstruction.model.kplanes import KPlanes


def bilinear(plane: np.ndarray, x: float, y: float) -> np.ndarray:
    """Bilinear sample (C,) of a plane (C, rows, columns). The coordinates ``x`` along columns and ``y`` along rows are
    in [-1, 1].
    """
    _, rows, columns = plane.shape
    column, row = (x + 1) / 2 * (columns - 1), (y + 1) / 2 * (rows - 1)
    left, top = min(int(column), columns - 2), min(int(row), rows - 2)
    a, b = column - left, row - top
    upper = plane[:, top, left] * (1 - a) + plane[:, top, left + 1] * a
    lower = plane[:, top + 1, left] * (1 - a) + plane[:, top + 1, left + 1] * a
    return upper * (1 - b) + lower * b


def small(reduction: str = "concat", time: bool = True) -> KPlanes:
    config = PlanesConfig(levels=2, features=3, base_resolution=5, reduction=reduction, time=time)
    return KPlanes(config, (1.0, 0.5, 0.8), frame_count=4)


@pytest.mark.parametrize("reduction", ["concat", "sum", "product"])
def test_lookup_equals_bilinear_interpolation(reduction: str, rng: np.random.Generator) -> None:
    """Catches swapped axes of a plane, shifts by half a sample, and planes concatenated in the wrong order."""
    field = small(reduction)
    points = rng.uniform(-1, 1, (7, 4)).astype(np.float32)
    found = field(torch.from_numpy(points)).detach().numpy()
    for point, row in zip(points, found, strict=True):
        expected = []
        for level in range(2):
            samples = []
            for i, (first, second) in enumerate(field.pairs):
                plane = field.planes[level * 6 + i].detach().numpy().transpose(2, 0, 1)
                samples.append(bilinear(plane, point[first], point[second]))
            reduced = {"concat": np.concatenate, "sum": sum, "product": lambda s: np.prod(s, axis=0)}[reduction]
            expected.append(reduced(samples))
        np.testing.assert_allclose(row, np.concatenate(expected), atol=1e-5)


def test_out_features_is_the_width() -> None:
    for reduction in ("concat", "sum", "product"):
        field = small(reduction)
        assert field(torch.zeros(2, 4)).shape == (2, field.out_features)


def test_time_changes_features_only_with_time_planes() -> None:
    """Catches a config key ``time`` that has no effect."""

    def difference(field: KPlanes) -> Tensor:
        early = torch.tensor([[0.1, 0.2, 0.3, -1.0]])
        late = torch.tensor([[0.1, 0.2, 0.3, 1.0]])
        return (field(early) - field(late)).abs().max()

    assert difference(small(time=True)) > 1e-3
    assert difference(small(time=False)) == 0


def test_points_outside_are_clamped_to_the_border() -> None:
    field = small()
    inside = field(torch.tensor([[1.0, -1.0, 1.0, 1.0]]))
    outside = field(torch.tensor([[3.0, -9.0, 1.5, 1.0]]))
    torch.testing.assert_close(inside, outside)


def test_gradients_equal_finite_differences() -> None:
    field = small().double()
    points = torch.rand(5, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(3)) * 1.8 - 0.9
    assert torch.autograd.gradcheck(field, (points.requires_grad_(),))


def test_one_frame_has_valid_time_planes() -> None:
    """Catches a division by zero for a capture of one frame."""
    field = KPlanes(PlanesConfig(levels=1), (1.0, 1.0, 1.0), frame_count=1)
    assert torch.isfinite(field(torch.zeros(1, 4))).all()


def test_the_longest_side_gets_the_full_resolution() -> None:
    field = KPlanes(PlanesConfig(levels=1, base_resolution=64), (2.0, 1.0, 0.5), frame_count=10)
    assert [tuple(plane.shape[:2]) for plane in field.planes] == [
        (32, 64), (16, 64), (16, 32), (10, 64), (10, 32), (10, 16),
    ]  # fmt: skip
