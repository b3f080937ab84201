"""Normals of points, and their storage."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.scene.styles.normals import Visibility, decode_octahedral, encode_octahedral, estimate_normals


def unit_vectors(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_octahedral_normals_keep_their_direction(rng: np.random.Generator) -> None:
    """Catches a wrong fold of the lower half, and bytes that overflow at the corners."""
    corners = np.array(
        [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)]
    )
    normals = np.concatenate([unit_vectors(rng, 2000), corners / np.linalg.norm(corners, axis=1, keepdims=True)])
    found = decode_octahedral(encode_octahedral(normals))
    assert np.degrees(np.arccos(np.clip((found * normals).sum(1), -1, 1))).max() < 1.0


@pytest.mark.parametrize("has_views", [True, False])
def test_normals_of_a_noisy_sphere_point_outwards(has_views: bool, rng: np.random.Generator) -> None:
    """Catches normals that point inwards, and normals that follow the noise of the positions."""
    outwards = unit_vectors(rng, 3000)
    xyz = outwards * (1 + rng.normal(0, 0.005, (3000, 1)))
    centres = 4 * np.concatenate([np.eye(3), -np.eye(3)])
    rays = centres[None] - xyz[:, None]
    weights = np.maximum((rays * outwards[:, None]).sum(2), 0)
    normals = estimate_normals(xyz, Visibility(weights, centres) if has_views else None)
    cosines = (normals * outwards).sum(1)
    assert cosines.min() > 0.95
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)


def test_single_wrong_directions_are_outvoted(rng: np.random.Generator) -> None:
    """Catches normals with the wrong sign at single points that a camera sees through a gap in the surface. Such
    normals cause dark specks.
    """
    xyz = np.concatenate([rng.uniform(-1, 1, (2000, 2)), np.zeros((2000, 1))], 1)
    weights = np.tile([1.0, 0.0], (2000, 1))
    weights[rng.choice(2000, 60, replace=False)] = [0, 1]
    centres = np.array([[0.0, 0, 9], [0, 0, -9]])
    assert estimate_normals(xyz, Visibility(weights, centres))[:, 2].min() > 0.99


def test_normals_of_thin_parts_face_the_cameras(rng: np.random.Generator) -> None:
    """Catches normals of thin parts, such as legs, that are estimated from points on the opposite side. Such normals
    cause light and dark patches.
    """
    count, radius = 6000, 0.02
    angle, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 4, count)
    outwards = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], 1)
    xyz = outwards * (radius + rng.normal(0, 0.008, (count, 1))) + height[:, None] * [0, 0, 1]
    turns = 2 * np.pi * np.arange(12) / 12
    centres = np.stack([5 * np.cos(turns), 5 * np.sin(turns), np.full(12, 2)], 1)
    rays = (centres[None] - xyz[:, None]) / 5
    weights = np.maximum((rays * outwards[:, None]).sum(2), 0)
    normals = estimate_normals(xyz, Visibility(weights, centres))
    cosines = (normals * outwards).sum(1)
    assert np.median(cosines) > 0.9
    assert (cosines < 0.3).mean() < 0.03


@pytest.mark.parametrize("count", [0, 1, 2, 3, 10])
def test_few_points_have_normals(count: int, rng: np.random.Generator) -> None:
    """Catches a neighbour search that fails for fewer points than neighbours, or points at one place."""
    for xyz in (rng.normal(size=(count, 3)), np.zeros((count, 3))):
        normals = estimate_normals(xyz)
        assert normals.shape == (count, 3)
        assert np.isfinite(normals).all()
        assert encode_octahedral(normals).shape == (count, 2)
