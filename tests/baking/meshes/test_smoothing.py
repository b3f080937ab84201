"""Smoothing of normals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fourd.base.formats.mesh import Mesh
from fourd.scene.meshes.smoothing import smooth_normals
from tests.baking.meshes.shapes import sphere


def test_noise_is_reduced(rng: np.random.Generator) -> None:
    """Catches smoothing over the wrong neighbours, and a seam where vertices have copies."""
    mesh = sphere(rings=60)
    assert mesh.normals is not None
    # The first and last vertex of each ring have the same position, and get the same noise.
    noise = rng.normal(0, 0.3, mesh.normals.reshape(60, 120, 3).shape)
    noise[:, -1] = noise[:, 0]
    noisy = replace(mesh, normals=(mesh.normals + noise.reshape(-1, 3)).astype(np.float32))
    found = smooth_normals(noisy).normals
    assert found is not None
    away_from_poles = np.abs(mesh.normals[:, 1]) < 0.9
    before = (noisy.normals * mesh.normals).sum(1)[away_from_poles]
    after = (found * mesh.normals).sum(1)[away_from_poles]
    assert np.median(np.arccos(np.clip(before, -1, 1))) > 0.3
    assert np.percentile(np.arccos(np.clip(after, -1, 1)), 95) < 0.15
    np.testing.assert_allclose(found.reshape(60, 120, 3)[5:-5, 0], found.reshape(60, 120, 3)[5:-5, -1], atol=1e-5)


def test_sharp_edges_stay_sharp() -> None:
    """Catches smoothing of normals across the sharp edges of a cube."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    xyz, triangles = [], []
    for axis in range(3):
        for side in (0, 1):
            index = len(xyz)
            xyz += list(corners[corners[:, axis] == side])
            triangles += [[index, index + 1, index + 2], [index + 1, index + 3, index + 2]]
    mesh = Mesh(np.array(xyz, np.float32), np.array(triangles, np.int32))
    found = smooth_normals(mesh).normals
    np.testing.assert_allclose(found, mesh.normals, atol=1e-6)
