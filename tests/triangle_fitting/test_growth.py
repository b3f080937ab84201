"""Pruning and growth: which triangles are removed, split or cloned, and the rows of the optimizer."""

from __future__ import annotations

import numpy as np
import torch

from fourd.base.cameras import Camera, look_at
from fourd.reconstruction.meshes.triangle_fitting.adam import AdamRows
from fourd.reconstruction.meshes.triangle_fitting.growth import longest_edges_px, prune_and_grow
from fourd.reconstruction.meshes.triangle_fitting.soup import Soup

INTRINSICS = np.array([[100.0, 0, 50], [0, 100.0, 50], [0, 0, 1]])


def camera() -> Camera:
    return look_at(np.array([0.0, 0, -2]), np.zeros(3), np.array([0.0, -1, 0]), INTRINSICS, 100, 100)


def soup_of(rng: np.random.Generator, count: int, side: float) -> Soup:
    corners = torch.tensor(rng.uniform(-0.3, 0.3, (count, 1, 3)), dtype=torch.float32)
    offsets = side * torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    return Soup(corners + offsets, torch.tensor(rng.random((count, 3)), dtype=torch.float32), side)


def grow(soup: Soup, weights: torch.Tensor, most: int = 1000) -> None:
    generator = torch.Generator().manual_seed(0)
    prune_and_grow(soup, weights, torch.ones(len(soup)), [camera()], most, generator)


def test_invisible_and_transparent_triangles_are_removed(rng: np.random.Generator) -> None:
    """Catches thresholds on the wrong quantity, and rows that are exchanged when triangles are removed."""
    soup = soup_of(rng, 20, 0.01)
    weights = torch.full((20,), 0.5)
    weights[:5] = 0.021
    soup.logits.value.data[5:8] = torch.logit(torch.tensor(0.013))
    colours = soup.colours.value.detach().clone()
    grow(soup, weights, most=12)
    assert len(soup) == 12
    torch.testing.assert_close(soup.colours.value.detach(), colours[8:])


def test_small_triangles_are_cloned_and_keep_the_opacity_of_the_pair(rng: np.random.Generator) -> None:
    """Catches a triangle and its clone that together are more opaque than the original triangle. Two triangles with the
    opacity 1 - sqrt(1 - o) together have the opacity o.
    """
    soup = soup_of(rng, 20, 0.01)
    before = soup.opacity(0.0).detach().clone()
    assert longest_edges_px(soup.corners.value.detach(), [camera()]).max() < 24
    grow(soup, torch.ones(20))
    assert len(soup) == 26
    opacity = soup.opacity(0.0).detach()
    clones = opacity[20:]
    torch.testing.assert_close(1 - (1 - clones) ** 2, before[:6], atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.sort(opacity).values[:12], clones.repeat(2), atol=1e-5, rtol=0)


def test_large_triangles_are_split_in_four(rng: np.random.Generator) -> None:
    """Catches parts that do not cover their triangle, and a split triangle that remains beside its parts."""
    soup = soup_of(rng, 20, 0.8)
    area = triangle_areas(soup.corners.value.detach())
    assert longest_edges_px(soup.corners.value.detach(), [camera()]).min() > 24
    grow(soup, torch.ones(20))
    assert len(soup) == 26
    parts = triangle_areas(soup.corners.value.detach())
    torch.testing.assert_close(parts.sum(), area.sum())
    torch.testing.assert_close(parts[18:], torch.full((8,), float(area[0]) / 4))


def test_nothing_changes_if_all_triangles_would_be_removed(rng: np.random.Generator) -> None:
    """Catches a fit that continues without triangles."""
    soup = soup_of(rng, 5, 0.01)
    grow(soup, torch.zeros(5))
    assert len(soup) == 5


def test_optimizer_state_follows_the_rows(rng: np.random.Generator) -> None:
    """Catches moments of Adam that belong to other triangles after rows are removed."""
    start = torch.tensor(rng.normal(size=(6, 2)), dtype=torch.float32)
    gradients = torch.tensor(rng.normal(size=(4, 6, 2)), dtype=torch.float32)
    kept, whole = torch.tensor([4, 1, 2]), AdamRows(start, 0.1)
    reduced = AdamRows(start, 0.1)
    for gradient in gradients[:2]:
        whole.step(gradient)
        reduced.step(gradient)
    reduced.replace(kept, torch.zeros(1, 2))
    for gradient in gradients[2:]:
        whole.step(gradient)
        reduced.step(torch.cat([gradient[kept], torch.ones(1, 2)]))
    torch.testing.assert_close(reduced.value[:3], whole.value[kept])
    # Adam moves a new row by the rate in each step if its gradient is constant.
    torch.testing.assert_close(reduced.value[3].detach(), torch.full((2,), -0.2))


def triangle_areas(corners: torch.Tensor) -> torch.Tensor:
    a, b, c = corners.unbind(1)
    return torch.linalg.cross(b - a, c - a).norm(dim=1) / 2
