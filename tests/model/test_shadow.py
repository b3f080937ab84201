"""The field of shadows: where it reaches, and what it leaves alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fourd.model.shadow import FADE, Shadow, ShadowField

LOWER, UPPER = np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 2.0])


def field(strength: float) -> ShadowField:
    """A field whose planes are drawn with numbers of that size: 0 is an untrained one."""
    made = ShadowField(LOWER, UPPER, 4)
    with torch.no_grad():
        for plane in made.planes.parameters():
            plane += strength * torch.randn(plane.shape)
    return made


def places(rng: np.random.Generator, count: int = 500) -> torch.Tensor:
    return torch.from_numpy(rng.uniform(-4, 4, (count, 3)).astype(np.float32))


def test_an_untrained_field_changes_nothing(rng: np.random.Generator) -> None:
    """Catches a start that is near 1: with it a background begins in twilight."""
    shadow = field(0)(places(rng), 0.3)
    assert torch.equal(shadow.factor, torch.ones(500))
    assert 0 < int(shadow.is_inside.sum()) < 500


def test_shadows_end_softly_around_what_moves(rng: np.random.Generator) -> None:
    """Catches an edge in the light where the region ends, and shadows across the room."""
    made = field(3.0)
    xyz = places(rng)
    with torch.no_grad():
        shadow = made(xyz, 0.6)
    beyond = ((xyz < torch.tensor([-1.5, -1.5, -1.0])) | (xyz > torch.tensor([1.5, 1.5, 3.0]))).any(1)
    assert torch.equal(shadow.is_inside, ~beyond)
    assert bool((shadow.factor[beyond] == 1).all())
    inside = shadow.factor[~beyond]
    assert float(inside.min()) > 0
    assert float(inside.max()) < 255 / 128 + 1e-6
    assert float((inside - 1).abs().max()) > 0.2
    middle = torch.tensor([0.0, 0.0, 1.0])
    x = torch.linspace(1.4, 1.5, 50)
    with torch.no_grad():
        rim = (made(x[:, None] * torch.tensor([1.0, 0, 0]) + middle, 0.6).factor - 1).abs()
    assert bool((rim <= (1.5 - x) / 1.5 / FADE + 1e-5).all())


@pytest.mark.parametrize("xyz", [torch.zeros(0, 3), torch.full((3, 3), 90.0), torch.full((2, 3), torch.nan)])
def test_points_out_of_reach_cost_and_change_nothing(xyz: torch.Tensor) -> None:
    """Catches a mean over no points, and NaN that a point far away brings."""
    made = field(1.0)
    assert torch.equal(made(xyz, 0.5).factor, torch.ones(len(xyz)))
    deviation = made.mean_squared_deviation(xyz, 0.5)
    assert deviation.item() == 0
    deviation.backward()


def test_what_is_in_reach_teaches_the_shadow_alone() -> None:
    """Catches a background that learns the shadow as its own colour."""
    colour = torch.rand(2, 3, requires_grad=True)
    factor = torch.tensor([0.5, 1.0], requires_grad=True)
    shadow = Shadow(factor, torch.tensor([True, False]))
    cast = shadow.apply(colour)
    torch.testing.assert_close(cast, colour * torch.tensor([[0.5], [1.0]]))
    (cast.sum() + shadow.detach_inside(colour).sum()).backward()
    assert colour.grad is not None
    assert factor.grad is not None
    assert colour.grad.tolist() == [[0, 0, 0], [2, 2, 2]]
    torch.testing.assert_close(factor.grad, colour.detach().sum(1))


def test_every_part_of_the_field_learns(rng: np.random.Generator) -> None:
    """Catches planes or layers that are built and never asked, and the time left out."""
    made = field(0.1)
    xyz = 0.3 * places(rng)
    made.mean_squared_deviation(xyz, 0.4).backward()
    silent = [name for name, value in made.named_parameters() if value.grad is None or not value.grad.abs().sum() > 0]
    assert silent == []
    assert not torch.equal(made(xyz, 0.0).factor, made(xyz, 1.0).factor)
