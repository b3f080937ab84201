"""The shadow field: its extent, its fade and its gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fourd.reconstruction.model.shadow import FADE, Shadow, ShadowField

LOWER, UPPER = np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 2.0])


def field(strength: float) -> ShadowField:
    """A shadow field with random planes of the given standard deviation. With a standard deviation of 0, the field
    equals an untrained field."""
    shadows = ShadowField(LOWER, UPPER, 4)
    with torch.no_grad():
        for plane in shadows.planes.parameters():
            plane += strength * torch.randn(plane.shape)
    return shadows


def random_points(rng: np.random.Generator, count: int = 500) -> torch.Tensor:
    return torch.from_numpy(rng.uniform(-4, 4, (count, 3)).astype(np.float32))


def test_an_untrained_field_is_the_identity(rng: np.random.Generator) -> None:
    """Catches an initial shadow factor that is not exactly 1 and darkens the whole background."""
    shadow = field(0)(random_points(rng), 0.3)
    assert torch.equal(shadow.factor, torch.ones(500))
    assert 0 < int(shadow.is_inside.sum()) < 500


def test_shadows_fade_out_around_the_foreground(rng: np.random.Generator) -> None:
    """Catches a visible edge at the border of the shadow field, and shadows outside the field."""
    shadows = field(3.0)
    xyz = random_points(rng)
    with torch.no_grad():
        shadow = shadows(xyz, 0.6)
    outside = ((xyz < torch.tensor([-1.5, -1.5, -1.0])) | (xyz > torch.tensor([1.5, 1.5, 3.0]))).any(1)
    assert torch.equal(shadow.is_inside, ~outside)
    assert bool((shadow.factor[outside] == 1).all())
    inside = shadow.factor[~outside]
    assert float(inside.min()) > 0
    assert float(inside.max()) < 255 / 128 + 1e-6
    assert float((inside - 1).abs().max()) > 0.2
    middle = torch.tensor([0.0, 0.0, 1.0])
    x = torch.linspace(1.4, 1.5, 50)
    with torch.no_grad():
        rim = (shadows(x[:, None] * torch.tensor([1.0, 0, 0]) + middle, 0.6).factor - 1).abs()
    assert bool((rim <= (1.5 - x) / 1.5 / FADE + 1e-5).all())


@pytest.mark.parametrize("xyz", [torch.zeros(0, 3), torch.full((3, 3), 90.0), torch.full((2, 3), torch.nan)])
def test_points_outside_have_no_shadow_and_no_penalty(xyz: torch.Tensor) -> None:
    """Catches a NaN penalty if there are no points inside the shadow field, and NaN from distant points."""
    shadows = field(1.0)
    assert torch.equal(shadows(xyz, 0.5).factor, torch.ones(len(xyz)))
    deviation = shadows.mean_squared_deviation(xyz, 0.5)
    assert deviation.item() == 0
    deviation.backward()


def test_points_inside_train_the_shadow_alone() -> None:
    """Catches background colours inside the shadow field that get a gradient from shadowed images."""
    colour = torch.rand(2, 3, requires_grad=True)
    factor = torch.tensor([0.5, 1.0], requires_grad=True)
    shadow = Shadow(factor, torch.tensor([True, False]))
    shadowed = shadow.apply(colour)
    torch.testing.assert_close(shadowed, colour * torch.tensor([[0.5], [1.0]]))
    (shadowed.sum() + shadow.detach_inside(colour).sum()).backward()
    assert colour.grad is not None
    assert factor.grad is not None
    assert colour.grad.tolist() == [[0, 0, 0], [2, 2, 2]]
    torch.testing.assert_close(factor.grad, colour.detach().sum(1))


def test_all_parameters_of_the_field_have_a_gradient(rng: np.random.Generator) -> None:
    """Catches planes or layers of the shadow field that are not used, and a field that ignores time."""
    shadows = field(0.1)
    xyz = 0.3 * random_points(rng)
    shadows.mean_squared_deviation(xyz, 0.4).backward()
    without_gradient = [
        name for name, value in shadows.named_parameters() if value.grad is None or not value.grad.abs().sum() > 0
    ]
    assert without_gradient == []
    assert not torch.equal(shadows(xyz, 0.0).factor, shadows(xyz, 1.0).factor)
