"""Mesh losses: hand-computed values, and gradients against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

from fourd.reconstruction.meshes.surface.components import drop_crumbs
from fourd.reconstruction.meshes.surface.losses import (
    MeshTopology,
    edge_length_loss,
    laplacian_loss,
    normal_consistency_loss,
    vertex_normals,
)


def tetrahedron() -> tuple[Tensor, Tensor]:
    """A regular tetrahedron with edges of length sqrt(8)."""
    xyz = torch.tensor([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=torch.float64)
    return xyz, torch.tensor([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def test_edges_occur_once() -> None:
    """Catches shared edges that are counted twice, and missing pairs of neighbouring triangles."""
    xyz, triangles = tetrahedron()
    topology = MeshTopology.of(triangles, len(xyz))
    assert topology.edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert sorted(sorted(pair) for pair in topology.neighbours.tolist()) == [
        [0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3],
    ]  # fmt: skip


def test_values_of_a_tetrahedron() -> None:
    """Catches a wrong mean. Each vertex v is at distance |v| 4/3 from the mean of the other vertices. The cosine
    between the normals of neighbouring faces is -1/3."""
    xyz, triangles = tetrahedron()
    topology = MeshTopology.of(triangles, len(xyz))
    assert float(laplacian_loss(xyz, topology)) == pytest.approx(3 * (4 / 3) ** 2)
    assert float(normal_consistency_loss(xyz, triangles, topology)) == pytest.approx(4 / 3)
    assert float(edge_length_loss(xyz, topology)) == pytest.approx(0, abs=1e-20)
    assert float(edge_length_loss(xyz, topology, 2 * 8**0.5)) == pytest.approx(0.25)
    normals = vertex_normals(xyz, triangles)
    torch.testing.assert_close(normals, xyz / 3**0.5)


def test_gradients_match_finite_differences(rng: np.random.Generator) -> None:
    """Catches wrong derivatives."""
    sphere = trimesh.creation.icosphere(subdivisions=1)
    triangles = torch.from_numpy(np.array(sphere.faces))
    xyz = torch.from_numpy(np.array(sphere.vertices) + 0.1 * rng.standard_normal(sphere.vertices.shape))
    xyz.requires_grad_()
    topology = MeshTopology.of(triangles, len(xyz))
    assert torch.autograd.gradcheck(lambda p: laplacian_loss(p, topology), (xyz,))
    assert torch.autograd.gradcheck(lambda p: normal_consistency_loss(p, triangles, topology), (xyz,))
    assert torch.autograd.gradcheck(lambda p: edge_length_loss(p, topology, 0.3), (xyz,))


def test_degenerate_meshes_have_finite_gradients() -> None:
    """Catches NaN gradients of triangles without area, and divisions by zero for empty meshes."""
    xyz = torch.zeros(3, 3, requires_grad=True)
    for triangles in (torch.tensor([[0, 1, 2]]), torch.zeros(0, 3, dtype=torch.int64)):
        topology = MeshTopology.of(triangles, 3)
        loss = laplacian_loss(xyz, topology) + edge_length_loss(xyz, topology)
        loss = loss + normal_consistency_loss(xyz, triangles, topology)
        (gradient,) = torch.autograd.grad(loss, xyz)
        assert torch.isfinite(loss)
        assert torch.isfinite(gradient).all()
    with pytest.raises(ValueError, match="length: expected more than 0"):
        edge_length_loss(xyz, topology, 0.0)


def test_crumbs_and_cavities_are_removed() -> None:
    """Catches small detached parts and inner surfaces in the exported meshes."""
    body, crumb, cavity = (trimesh.creation.icosphere(radius=radius) for radius in (1.0, 0.05, 0.5))
    crumb.apply_translation([2, 0, 0])
    cavity.invert()
    mesh = trimesh.util.concatenate([crumb, body, cavity])
    xyz, triangles = drop_crumbs(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces))
    assert len(triangles) == len(body.faces)
    assert np.abs(np.linalg.norm(xyz, axis=1) - 1).max() < 1e-5
    assert trimesh.Trimesh(xyz, triangles, process=False).is_watertight
