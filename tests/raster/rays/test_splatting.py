"""Soft triangles along rays, compared with rasterized soft triangles: pictures and gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.rays import Bvh, splat_along_rays
from fourd.rendering.triangles import splat_triangles
from fourd.scene.lenses.lens import Pinhole
from tests.baking.scenes import ring

Soup = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]


def stacked_soup(rng: np.random.Generator, camera: Camera, count: int) -> Soup:
    """Return xyz, tri, features, opacity and sigma of triangles at increasing depths. Their depth ranges do not
    overlap, so that both methods composite the triangles in the same order."""
    depth = np.linspace(1.5, 5.0, count)[:, None, None] + rng.uniform(-0.4, 0.4, (count, 3, 1)) * 3.5 / count
    # There are no slivers, because rounding of hits on slivers would change their large gradients.
    angles = np.radians([0, 120, 240]) + rng.uniform(0, 2 * np.pi, (count, 1)) + rng.uniform(-0.5, 0.5, (count, 3))
    corners = rng.uniform(0.06, 0.25, (count, 1, 1)) * np.stack([np.cos(angles), np.sin(angles)], -1)
    across = (rng.uniform(-0.35, 0.35, (count, 1, 2)) + corners) * depth
    local = np.concatenate([across, depth], -1).reshape(-1, 3)
    xyz = torch.from_numpy(((local - camera.translation) @ camera.rotation).astype(np.float32))
    values = (rng.random((count, 3)), rng.uniform(0.2, 1.0, count), rng.uniform(0.3, 2.0, count))
    features, opacity, sigma = (torch.from_numpy(value.astype(np.float32)) for value in values)
    return xyz, torch.arange(3 * count, dtype=torch.int32).reshape(-1, 3), features, opacity, sigma


def pixel_rays(camera: Camera) -> tuple[Tensor, Tensor]:
    rays = Pinhole().rays(camera)
    origins, directions = (np.array(array, np.float32) for array in (rays.origins, rays.directions))
    return torch.from_numpy(origins), torch.from_numpy(directions)


@pytest.mark.parametrize("layers", [None, 3])
def test_picture_and_gradients_equal_the_rasterized_ones(layers: int | None, rng: np.random.Generator) -> None:
    """Catches window functions of the wrong edges, weights without perspective correction, hits that are lost between
    chunks, and wrong gradients.
    """
    camera = ring(3, size=40)[1]
    xyz, tri, features, opacity, sigma = stacked_soup(rng, camera, 60)
    origins, directions = pixel_rays(camera)
    upstream = torch.from_numpy(rng.normal(0, 1, (1600, 4)).astype(np.float32))
    results = []
    for is_traced in (False, True):
        leaves = [value.clone().requires_grad_() for value in (xyz, features, opacity, sigma)]
        if is_traced:
            bvh = Bvh.build(leaves[0], tri)
            found = splat_along_rays(bvh, *leaves, origins, directions, camera=camera, layers=layers)
            picture = torch.cat([found.features, found.alpha[:, None]], 1)
        else:
            image = splat_triangles(leaves[0], tri, *leaves[1:], camera, layers=layers, geometry=False)
            picture = torch.cat([image.features, image.alpha[..., None]], 2).reshape(-1, 4)
        results.append((picture.detach(), torch.autograd.grad((picture * upstream).sum(), leaves)))
    (expected, gradients), (found_picture, found_gradients) = results
    assert float((found_picture - expected).abs().mean()) <= 1e-5
    assert float(expected[:, 3].max()) > 0.7
    # Rounding decides whether a ray near an edge hits the triangle. This affects the gradient of positions most.
    for one, other, bound in zip(found_gradients, gradients, (0.05, 1e-3, 1e-3, 2e-3), strict=True):
        assert float((one - other).norm() / other.norm()) <= bound


def test_many_layers_are_composited_in_chunks(rng: np.random.Generator) -> None:
    """Catches chunks that start at the wrong hit. The test composites 50 nearly transparent triangles behind each
    other.
    """
    corners = torch.tensor([[-1.0, -1, 0], [2, -1, 0], [-1, 2, 0]]).repeat(50, 1, 1)
    corners[:, :, 2] = torch.arange(50)[:, None] * 0.1
    tri = torch.arange(150, dtype=torch.int32).reshape(-1, 3)
    xyz = corners.reshape(-1, 3)
    opacity, sigma = torch.full((50,), 0.05), torch.full((50,), 1e-6)
    features = torch.arange(50.0)[:, None]
    ray = torch.tensor([[0.0, 0, -1]]), torch.tensor([[0.0, 0, 1]])
    found = splat_along_rays(Bvh.build(xyz, tri), xyz, features, opacity, sigma, *ray)
    weights = 0.05 * 0.95 ** torch.arange(50)
    torch.testing.assert_close(found.alpha, 1 - torch.tensor([0.95**50]), rtol=1e-4, atol=0)
    torch.testing.assert_close(found.features[0], (weights * features[:, 0]).sum()[None], rtol=1e-4, atol=0)


def test_the_window_in_space_does_not_depend_on_the_ray(rng: np.random.Generator) -> None:
    """Catches a window function that depends on the viewing direction. The alpha of a point on a triangle must be equal
    in all directions.
    """
    xyz = torch.from_numpy(rng.normal(0, 1, (3, 3)).astype(np.float32))
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    lengths = torch.stack([(xyz[2] - xyz[1]).norm(), (xyz[0] - xyz[2]).norm(), (xyz[1] - xyz[0]).norm()])
    incentre = (lengths[:, None] * xyz).sum(0) / lengths.sum()
    origins = torch.from_numpy(rng.normal(0, 3, (20, 3)).astype(np.float32))
    values = torch.ones(1, 1), torch.tensor([0.8]), torch.tensor([1.5])
    found = splat_along_rays(Bvh.build(xyz, tri), xyz, *values, origins, incentre - origins)
    torch.testing.assert_close(found.alpha, torch.full((20,), 0.8), rtol=1e-3, atol=0)


def test_wrong_arguments_are_named(rng: np.random.Generator) -> None:
    """Catches features with one row per vertex that are accepted although one row per triangle is needed."""
    camera = ring(1)[0]
    xyz, tri, _features, opacity, sigma = stacked_soup(rng, camera, 5)
    bvh = Bvh.build(xyz, tri)
    with pytest.raises(ValueError, match=r"features: expected shape \(5, C\), got \(15, 3\)"):
        splat_along_rays(bvh, xyz, torch.zeros(15, 3), opacity, sigma, *pixel_rays(camera))
