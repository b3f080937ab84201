"""Connected meshes of separate triangles."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
import trimesh

from fourd.reconstruction.carving.hull import Silhouettes
from fourd.reconstruction.meshes.triangle_fitting.connect import close_holes, connect_triangles, visible_points
from fourd.reconstruction.meshes.triangle_fitting.neighbours import Neighbours, smoothness_loss
from tests.captures import ring_cameras

RADIUS = 0.4


def ball_triangles() -> tuple[trimesh.Trimesh, torch.Tensor]:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    return ball, torch.tensor(ball.triangles, dtype=torch.float32)


def hull(radius: float) -> Silhouettes:
    """A visual hull from masks that are discs. The hull contains a ball of radius ``radius``."""
    cameras, masks = ring_cameras(8, 64), []
    for camera in cameras:
        distance = float(np.linalg.norm(camera.centre))
        pixels = 1.1 * 64 * radius / np.sqrt(distance**2 - radius**2)
        mask = np.zeros((64, 64), np.uint8)
        masks.append(cv2.circle(mask, (32 * 16, 32 * 16), round(pixels * 16), 255, -1, cv2.LINE_AA, 4))
    return Silhouettes.from_masks(masks, cameras, np.zeros(3), agreement=0.95, least_views=0.5)


def test_separate_triangles_become_a_closed_surface_at_their_place(rng: np.random.Generator) -> None:
    """Catches a surface that is shifted, inside out, open or made of several parts."""
    _, corners = ball_triangles()
    corners = corners[torch.from_numpy(rng.permutation(len(corners)))]
    # Separate triangles may face inwards.
    flipped = torch.from_numpy(rng.random(len(corners)) < 0.3)
    corners[flipped] = corners[flipped][:, [0, 2, 1]]
    points = visible_points(corners, ring_cameras(8, 64))
    assert ((points.xyz * points.normals).sum(axis=1) > 0).all()
    xyz, tri = connect_triangles(points, hull(0.5), 0.04)
    mesh = trimesh.Trimesh(xyz.numpy(), tri.numpy(), process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.1)
    # No camera sees the poles well.
    seen = xyz.numpy()[np.abs(xyz.numpy()[:, 2]) < 0.2]
    assert np.abs(np.linalg.norm(seen, axis=1) - RADIUS).max() < 0.02


def test_the_surface_stays_inside_the_hull() -> None:
    """Catches a distance that ignores the mattes."""
    _, corners = ball_triangles()
    views = hull(0.35)
    xyz, _ = connect_triangles(visible_points(corners, ring_cameras(8, 64)), views, 0.04)
    assert views.distance(np.ascontiguousarray(xyz.numpy().T))[0].min() > -0.01


def test_holes_are_closed(rng: np.random.Generator) -> None:
    """Catches caps that face inwards, and two holes that are closed by one cap."""
    ball, _ = ball_triangles()
    centres = ball.triangles_center / RADIUS
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    kept = np.abs(centres @ axis) < 0.8
    xyz, triangles = close_holes(np.asarray(ball.vertices, np.float32), ball.faces[kept])
    closed = trimesh.Trimesh(xyz, triangles, process=False)
    assert closed.is_watertight
    assert closed.is_winding_consistent
    assert len(xyz) == len(ball.vertices) + 2
    assert 0.85 * ball.volume < closed.volume < ball.volume
    same, faces = close_holes(np.asarray(ball.vertices, np.float32), ball.faces)
    assert len(same) == len(ball.vertices)
    assert len(faces) == len(ball.faces)


def test_smoothness_is_zero_on_a_plane_and_neighbours_are_on_one_side(rng: np.random.Generator) -> None:
    """Catches normals and planes that are compared across a thin part, and distances that are not in spacings."""
    place = torch.tensor(rng.uniform(0, 1, (200, 1, 2)), dtype=torch.float32)
    flat = place + 0.02 * torch.tensor([[0.0, 0], [1, 0], [0, 1]])
    front = torch.nn.functional.pad(flat, (0, 1), value=0.01)
    back = torch.nn.functional.pad(flat, (0, 1), value=-0.01)[:, [0, 2, 1]]
    both = torch.cat([front, back])
    pairs = Neighbours.of(both)
    assert len(pairs.first) > 400
    assert ((pairs.first < 200) == (pairs.second < 200)).all()
    plane, normal = smoothness_loss(both, pairs, 0.05)
    assert float(plane) < 1e-6
    assert float(normal) < 1e-6
    bumpy = front + 0.01 * torch.tensor(rng.normal(size=(200, 1, 3)), dtype=torch.float32)
    small = smoothness_loss(bumpy, Neighbours.of(bumpy), 0.1)[0]
    torch.testing.assert_close(smoothness_loss(bumpy, Neighbours.of(bumpy), 0.2)[0], small / 4)
