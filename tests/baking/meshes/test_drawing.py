"""Surfaces and styles of meshes, compared with exact values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fourd.base.cameras import look_at
from fourd.rendering.ops.stylize.op import stylize_surface
from fourd.scene.meshes import drawing
from fourd.scene.meshes.drawing import draw_mesh
from tests.baking.meshes.shapes import DISTANCE, FOCAL, front_camera, plane, sphere
from tests.stylize.surfaces import line_parameters, make_plane, make_sphere

SIZE = 161


def lines_of(surface, **changes: object) -> np.ndarray:
    """(H, W) strength of black lines of a surface, in [0, 1]."""
    state = np.zeros(surface.size, np.uint32)
    stylize_surface(surface, line_parameters(SIZE, **changes), line_state=state)
    return (state & 255) / 255


def test_the_surface_of_a_sphere_is_exact() -> None:
    """Catches a mesh that is mirrored or shifted by half a pixel, depths along rays, and normals in world axes."""
    exact, found = make_sphere(SIZE), draw_mesh(sphere(), front_camera(SIZE), samples=1).surface()
    both = (exact.normal[..., 3] == 255) & (found.normal[..., 3] == 255)
    assert (exact.normal[..., 3] != found.normal[..., 3]).mean() < 0.003
    np.testing.assert_allclose(found.inverse_depth[both], exact.inverse_depth[both], rtol=2e-3)
    assert np.abs(found.normal[both].astype(int) - exact.normal[both]).max() <= 3
    assert (found.albedo[both] == (200, 120, 60, 255)).all()
    assert (found.normal[0, 0] == (128, 128, 128, 0)).all()


@pytest.mark.parametrize("samples", [1, 3])
def test_the_silhouette_ring_has_the_radius_of_the_outline(samples: int) -> None:
    """Catches an outline that is missing, too thick or at the wrong position, and lines inside the sphere."""
    surface = draw_mesh(sphere(), front_camera(SIZE), samples=samples).surface()
    lines = lines_of(surface, depth_threshold=0.3, normal_threshold=9.0)
    outline = FOCAL * 1.0 / np.sqrt(DISTANCE**2 - 1)
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5 - SIZE / 2
    radius = np.hypot(x, y)
    assert (lines[np.abs(radius - outline) < 0.25] > 0.9).all()
    assert (lines[np.abs(radius - outline) > 2.5] == 0).all()


@pytest.mark.parametrize("threshold", [0.2, 0.4, 0.7])
def test_the_inner_ring_has_the_radius_of_the_threshold(threshold: float) -> None:
    """Catches surface-angle darkening that uses the viewing axis instead of the ray, or that uses normals and rays in
    different coordinate systems.
    """
    surface = draw_mesh(sphere(), front_camera(SIZE), samples=1).surface()
    changes = {"angle_threshold": threshold, "angle_softness": 1e-4, "angle_strength": 1.0}
    picture = stylize_surface(surface, line_parameters(SIZE, lines="none", **changes))
    # On the ring, N.V = c. The angle a between the viewing axis and the ring has sin(a) = r * sqrt(1 - c^2) / d.
    angle = np.arcsin(np.sqrt(1 - threshold**2) / DISTANCE)
    ring = FOCAL * np.tan(angle)
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5 - SIZE / 2
    radius = np.hypot(x, y)
    is_dark = picture[..., :3].max(2) < 20
    assert not is_dark[radius < ring - 1.5].any()
    outline = FOCAL / np.sqrt(DISTANCE**2 - 1)
    assert is_dark[(radius > ring + 1.5) & (radius < outline - 1.5)].all()


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.6, 0, -0.8), (-0.3, 0.5, -0.8)])
@pytest.mark.parametrize("samples", [1, 2])
def test_a_plane_has_no_edge(normal: tuple[float, float, float], samples: int) -> None:
    """Catches lines along the diagonal of two triangles, and depths without correct perspective."""
    surface = draw_mesh(plane(normal), front_camera(SIZE), samples=samples).surface()
    exact = make_plane(SIZE, normal)
    np.testing.assert_allclose(surface.inverse_depth, exact.inverse_depth, rtol=1e-4)
    for lines in ("sobel", "cross"):
        assert (lines_of(surface, lines=lines, depth_threshold=0.02) == 0).all()


def test_colours_and_back_sides() -> None:
    """Catches a texture that is upside down, and normals of back sides that point away from the camera."""
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:32, :, 0], texture[32:, :32, 1], texture[32:, 32:, 2] = 255, 255, 255
    front = draw_mesh(plane((0, 0, -1), texture), front_camera(SIZE), samples=2)
    picture = front.picture(np.zeros(3, np.float32))
    for at, expected in (((40, 40), (1, 0, 0)), ((120, 40), (0, 1, 0)), ((120, 120), (0, 0, 1))):
        np.testing.assert_allclose(picture[at], expected, atol=0.02)
    mesh = plane((0, 0, -1), texture)
    behind = look_at(
        np.array([0, 0, 2 * DISTANCE]),
        np.array([0, 0, DISTANCE]),
        np.array([0.0, -1, 0]),
        front_camera(SIZE).intrinsics,
        SIZE,
        SIZE,
    )
    for shown in (mesh, replace(mesh, triangles=mesh.triangles[:, ::-1].copy(), normals=None)):
        for camera in (front_camera(SIZE), behind):
            normal = draw_mesh(shown, camera, samples=1).surface().normal
            assert (normal[80, 80] == (128, 128, 1, 255)).all()


def test_a_mesh_that_surrounds_the_camera() -> None:
    """Catches triangles behind the camera that are drawn, and a near plane that cuts off visible triangles."""
    mesh = sphere(radius=10.0)
    buffer = draw_mesh(mesh, front_camera(SIZE), samples=1)
    assert (buffer.alpha == 1).all()
    np.testing.assert_allclose(buffer.depth[80, 80], DISTANCE + 10, rtol=1e-3)
    away = replace(front_camera(SIZE), translation=np.array([0, 0, -50.0]))
    assert (draw_mesh(mesh, away, samples=1).alpha == 0).all()


@pytest.mark.parametrize("shift", [(0, 0, 0), (-0.9, 0.7, 0.0), (1.2, 0.1, -1.0), (9, 0, 0), (0, 0, -3.2)])
def test_only_the_box_of_the_mesh_is_drawn(shift: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a mesh that is cut off at the border of its bounding box, or that is drawn at the wrong position."""
    camera = replace(front_camera(SIZE), translation=np.array(shift, float))
    mesh = replace(sphere(rings=40), uv=None)
    fast = draw_mesh(mesh, camera, samples=2)
    monkeypatch.setattr(drawing, "_box", lambda xyz, camera: (0, 0, camera.width, camera.height))
    whole = draw_mesh(mesh, camera, samples=2)
    for name in ("rgb", "depth", "normal", "hits"):
        differs = np.abs(getattr(fast, name) - getattr(whole, name)) > 2e-3 * DISTANCE
        assert differs.mean() < 1e-3, name
