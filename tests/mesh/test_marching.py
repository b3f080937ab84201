"""Marching tetrahedra on a sphere: shape, orientation, closedness and gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

from fourd.reconstruction.meshes.surface.grid import TetrahedralGrid, box_grid, cube_grid
from fourd.reconstruction.meshes.surface.marching import marching_tetrahedra

RADIUS = 0.8


@pytest.fixture(scope="module")
def grid() -> TetrahedralGrid:
    return box_grid(np.full(3, -1.0), np.full(3, 1.0), 24)


def sphere_distance(xyz: Tensor) -> Tensor:
    return RADIUS - xyz.norm(dim=1)


def test_all_tetrahedra_have_the_same_positive_volume(grid: TetrahedralGrid) -> None:
    """Catches a tetrahedron of the wrong orientation, whose triangles would face inwards."""
    corners = grid.xyz.double()[grid.tetrahedra]
    volumes = torch.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    torch.testing.assert_close(volumes, torch.full_like(volumes, grid.side**3 / 12), rtol=1e-4, atol=0)


def test_border_vertices_are_those_on_faces_of_one_tetrahedron() -> None:
    """Catches an inner vertex that keeps its sign, or a border vertex at which the surface could be open."""
    cubes = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = cube_grid(cubes, np.zeros(3), 1.0)
    inner = ((grid.xyz > 0.9) & (grid.xyz < 3.1)).all(dim=1)
    assert not grid.is_border[inner].any()
    assert grid.is_border[~inner].all()


def test_the_sphere_is_closed_and_has_its_area_and_volume(grid: TetrahedralGrid) -> None:
    """Catches wrong rows of the triangle table: holes, flipped triangles, or vertices that are not on the edges."""
    surface = marching_tetrahedra(grid.xyz, sphere_distance(grid.xyz), grid.tetrahedra)
    mesh = trimesh.Trimesh(surface.xyz.numpy(), surface.triangles.numpy(), process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=5e-3)
    assert mesh.area == pytest.approx(4 * np.pi * RADIUS**2, rel=5e-3)
    assert float((surface.xyz.norm(dim=1) - RADIUS).abs().max()) < grid.side**2


def test_every_sign_pattern_gives_a_closed_surface(rng: np.random.Generator) -> None:
    """Catches a wrong row of the table that a sphere does not use."""
    grid = box_grid(np.full(3, -1.0), np.full(3, 1.0), 6)
    sdf = torch.from_numpy(rng.standard_normal(len(grid.xyz)).astype(np.float32))
    sdf[grid.is_border] = -1
    surface = marching_tetrahedra(grid.xyz, sdf, grid.tetrahedra)
    codes = ((sdf[grid.tetrahedra] > 0) * torch.tensor([1, 2, 4, 8])).sum(dim=1)
    assert set(codes.tolist()) == set(range(16))
    directed = torch.cat([surface.triangles[:, [0, 1]], surface.triangles[:, [1, 2]], surface.triangles[:, [2, 0]]])
    forward = set(map(tuple, directed.tolist()))
    assert len(forward) == len(directed)
    assert all((b, a) in forward for a, b in forward)


def test_gradients_match_finite_differences(rng: np.random.Generator) -> None:
    """Catches a wrong derivative with respect to distances or positions."""
    grid = box_grid(np.full(3, -1.0), np.full(3, 1.0), 2)
    xyz = grid.xyz.double() + 0.02 * torch.from_numpy(rng.standard_normal(grid.xyz.shape))
    sdf = sphere_distance(xyz)
    # Distances near 0 are moved away from 0, because finite steps across 0 would change the set of triangles.
    sdf = torch.where(sdf.abs() < 0.02, 0.02 * torch.sign(sdf) + 0.001, sdf)
    weights = torch.from_numpy(rng.standard_normal(marching_tetrahedra(xyz, sdf, grid.tetrahedra).xyz.shape))

    def value(positions: Tensor, distances: Tensor) -> Tensor:
        return (marching_tetrahedra(positions, distances, grid.tetrahedra).xyz.sin() * weights).sum()

    assert torch.autograd.gradcheck(value, (xyz.requires_grad_(), sdf.requires_grad_()), eps=1e-6, atol=1e-6)


def test_a_grid_without_surface_gives_an_empty_mesh(grid: TetrahedralGrid) -> None:
    """Catches an error for a grid without a surface."""
    surface = marching_tetrahedra(grid.xyz, torch.full((len(grid.xyz),), -1.0), grid.tetrahedra)
    assert surface.xyz.shape == (0, 3)
    assert surface.triangles.shape == (0, 3)


def test_bad_arguments_are_named(grid: TetrahedralGrid) -> None:
    """Catches messages that do not name the argument."""
    sdf = sphere_distance(grid.xyz)
    with pytest.raises(ValueError, match=r"sdf: expected shape \(\d+,\)"):
        marching_tetrahedra(grid.xyz, sdf[:-1], grid.tetrahedra)
    with pytest.raises(ValueError, match="sdf: expected finite"):
        marching_tetrahedra(grid.xyz, sdf * torch.nan, grid.tetrahedra)
    with pytest.raises(TypeError, match="tetrahedra: expected dtype int64"):
        marching_tetrahedra(grid.xyz, sdf, grid.tetrahedra.int())
    with pytest.raises(ValueError, match="tetrahedra: expected vertex indices from 0 to"):
        marching_tetrahedra(grid.xyz, sdf, grid.tetrahedra + len(sdf))
    with pytest.raises(ValueError, match="cubes: expected two cubes that share a face"):
        cube_grid(np.zeros((1, 3), np.int64), np.zeros(3), 1.0)
    with pytest.raises(ValueError, match="side: expected more than 0"):
        cube_grid(np.zeros((1, 3), np.int64), np.zeros(3), 0.0)
