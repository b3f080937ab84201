"""Distances to hulls, the photometric term, and the fit of a ball."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from fourd.base.errors import UserError
from fourd.reconstruction.carving.bounds import Bounds
from fourd.reconstruction.meshes.fitting.fit import fit_mesh
from fourd.reconstruction.meshes.fitting.hull_distance import DistanceGrid, hull_distance_grid
from fourd.reconstruction.meshes.fitting.settings import FitSettings
from fourd.reconstruction.meshes.surface.grid import box_grid
from fourd.reconstruction.meshes.surface.marching import marching_tetrahedra
from fourd.reconstruction.meshes.views import MeshView, mesh_views
from fourd.recording.capture import Capture, open_capture
from fourd.recording.capture.pictures.mask_source import frame_masks

CENTRE = np.array([0.0, 0.1, 0.0])
"""Centre of the ball of ``ball_capture`` in frame 0."""
BOX = Bounds(CENTRE - 0.5, CENTRE + 0.5)


@pytest.fixture(scope="module")
def capture(ball_capture: Path) -> Capture:
    return open_capture(ball_capture)


@pytest.fixture(scope="module")
def views(capture: Capture) -> list[MeshView]:
    images = [capture.image(camera, 0) for camera in range(len(capture.cameras))]
    return mesh_views(images, frame_masks(capture, 0), capture.cameras)


def sphere_start(radius: float, cells: int = 16) -> DistanceGrid:
    grid = box_grid(BOX.lower, BOX.upper, cells)
    distance = radius - (grid.xyz - torch.from_numpy(CENTRE).float()).norm(dim=1)
    return DistanceGrid(grid, distance)


def radii(xyz: np.ndarray) -> np.ndarray:
    return np.linalg.norm(xyz - CENTRE, axis=1)


@pytest.mark.parametrize("trim", [False, True])
def test_the_hull_surface_is_closed_and_near_the_ball(capture: Capture, trim: bool) -> None:
    """Catches a grid whose border cuts the surface, and distances in the wrong unit or with the wrong sign."""
    start = hull_distance_grid(frame_masks(capture, 0), capture.cameras, BOX, cells=24, trim=trim)
    surface = marching_tetrahedra(start.grid.xyz, start.sdf, start.grid.tetrahedra)
    mesh = trimesh.Trimesh(surface.xyz.numpy(), surface.triangles.numpy(), process=False)
    assert mesh.is_watertight
    assert mesh.volume > 0
    equator = np.abs(mesh.vertices[:, 2]) < 0.2
    assert np.abs(radii(mesh.vertices[equator]) - 0.4).mean() < 0.02
    assert float(start.sdf.abs().max()) <= 1.5 * start.grid.side * 1.001


def test_trimming_only_removes(capture: Capture) -> None:
    """Catches excess parts that are added instead of removed."""
    masks = frame_masks(capture, 0)
    whole = hull_distance_grid(masks, capture.cameras, BOX, cells=24, trim=False)
    cut = hull_distance_grid(masks, capture.cameras, BOX, cells=24, trim=True)
    volumes = []
    for start in (whole, cut):
        surface = marching_tetrahedra(start.grid.xyz, start.sdf, start.grid.tetrahedra)
        volumes.append(trimesh.Trimesh(surface.xyz.numpy(), surface.triangles.numpy(), process=False).volume)
    assert volumes[1] < volumes[0]
    assert volumes[1] > 0.9 * 4 / 3 * np.pi * 0.4**3


def test_silhouettes_shrink_and_grow_the_surface(views: list[MeshView]) -> None:
    """Catches a silhouette gradient that has the wrong sign, or that does not reach the distances."""
    settings = FitSettings(steps=48, rate=0.1, photo=0)
    for radius in (0.36, 0.43):
        fitted = fit_mesh(sphere_start(radius, 10), views, settings)
        equator = np.abs(fitted.xyz[:, 2]) < 0.2
        towards = (radii(fitted.xyz[equator]).mean() - radius) * np.sign(0.4 - radius)
        assert towards > 0.3 * abs(0.4 - radius), radius
        assert fitted.losses[-8:].mean() < 0.6 * fitted.losses[:8].mean()
        assert trimesh.Trimesh(fitted.xyz, fitted.triangles, process=False).is_watertight


def test_photo_consistency_finds_the_depth(views: list[MeshView]) -> None:
    """Catches a photometric term with a wrong projection. In this test, there is no silhouette term, so only the
    colours determine the position of the surface.
    """
    start = sphere_start(0.43, 10)
    fitted = fit_mesh(start, views, FitSettings(steps=40, rate=0.1, silhouette=0))
    equator = np.abs(fitted.xyz[:, 2]) < 0.2
    assert np.abs(radii(fitted.xyz[equator]) - 0.4).mean() < 0.014


def test_equal_seeds_give_equal_meshes(views: list[MeshView]) -> None:
    """Catches a fit that depends on anything but its arguments, so that resumed runs would differ."""
    settings = FitSettings(steps=5)
    one, two = (fit_mesh(sphere_start(0.42, 10), views, settings) for _ in range(2))
    np.testing.assert_array_equal(one.xyz, two.xyz)
    np.testing.assert_array_equal(one.triangles, two.triangles)


def test_without_steps_the_surface_is_the_start(views: list[MeshView]) -> None:
    """Catches offsets or distances that change before the first step."""
    start = sphere_start(0.42)
    fitted = fit_mesh(start, views, FitSettings(steps=0))
    surface = marching_tetrahedra(start.grid.xyz, start.sdf, start.grid.tetrahedra)
    np.testing.assert_allclose(fitted.xyz, surface.xyz.numpy(), atol=1e-6)
    assert len(fitted.losses) == 0


def test_bad_arguments_are_named(capture: Capture, views: list[MeshView]) -> None:
    """Catches messages that do not name the argument, and empty hulls that cause an unrelated error."""
    with pytest.raises(ValueError, match="views: expected at least 2"):
        fit_mesh(sphere_start(0.4), views[:1], FitSettings())
    with pytest.raises(ValueError, match="start: expected distances of both signs"):
        fit_mesh(sphere_start(-1.0), views, FitSettings())
    for values, message in (
        ({"steps": -1}, "steps: expected 0 or more"),
        ({"rate": 0.0}, "rate: expected more than 0"),
        ({"sources": 0}, "sources: expected at least 1"),
        ({"photo": float("nan")}, "photo: expected a weight of 0 or more"),
    ):
        with pytest.raises(ValueError, match=message):
            FitSettings(**values)
    masks = frame_masks(capture, 0)
    with pytest.raises(ValueError, match="cells: expected at least 1"):
        hull_distance_grid(masks, capture.cameras, BOX, cells=0)
    empty = [np.zeros_like(mask) for mask in masks]
    with pytest.raises(UserError, match="the frame: expected an object in the masks"):
        hull_distance_grid(empty, capture.cameras, BOX, cells=16, label="the frame")
