"""Antialiasing of shapes whose coverage of pixels is known, and the silhouettes of meshes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.antialias.topology import opposite_vertices
from fourd.rendering.triangles import antialias
from tests.ops.antialias.scenes import RECTANGLE, rasterize_brute_force, rectangle

HEIGHT, WIDTH = 9, 12
BACKENDS = ("cpu", "reference")


def covered(low: float, high: float, pixels: int) -> Tensor:
    """The fraction of each pixel that the interval from ``low`` to ``high`` covers."""
    edges = torch.arange(pixels + 1, dtype=torch.float64)
    return (edges[1:].clamp(max=high) - edges[:-1].clamp(min=low)).clamp(min=0)


def paint(pos: Tensor, tri: Tensor, height: int, width: int, backend: str, power: float = 1.0) -> Tensor:
    """The antialiased image (H, W) of white triangles on black. ``power`` multiplies x, y, z and w, and does not change
    the image."""
    clip = (pos * power)[None].float()
    rast = rasterize_brute_force(clip, tri, height, width)
    color = (rast[..., 3:] > 0).float()
    return antialias(color, rast, clip, tri, backend=backend)[0, ..., 0]  # type: ignore[arg-type]


@pytest.mark.parametrize("backend", BACKENDS)
def test_rectangle_equals_its_exact_coverage(backend: str, rng: np.random.Generator) -> None:
    """Catches a wrong sign of the weight, a wrong pixel of a pair, and rows or columns that are off by one."""
    row, column = torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5
    for _ in range(20):
        (x0, y0), (x1, y1) = rng.uniform((1.0, 1.0), (3.0, 2.5)), rng.uniform((9.0, 6.5), (11.0, 8.0))
        image = paint(rectangle(x0, y0, x1, y1, HEIGHT, WIDTH), RECTANGLE, HEIGHT, WIDTH, backend, rng.uniform(0.2, 5))
        expected = covered(y0, y1, HEIGHT)[:, None] * covered(x0, x1, WIDTH)
        # At two corners, pixels show the triangle that does not contain the nearest edge. These pixels are not
        # compared.
        near_x = torch.minimum((column - x0).abs(), (column - x1).abs()) < 3
        near_y = torch.minimum((row - y0).abs(), (row - y1).abs()) < 1.5
        found = torch.where(near_y[:, None] & near_x, expected, image.double())
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_half_plane_at_any_angle_is_close_to_its_coverage(backend: str, rng: np.random.Generator) -> None:
    """Catches edges that are blended along both axes, which doubles the change."""
    side = 16
    x, y = torch.meshgrid(*(torch.arange(side * 16, dtype=torch.float64) / 16 + 1 / 32,) * 2, indexing="xy")
    for _ in range(8):
        angle = rng.uniform(0, 2 * np.pi)
        normal = torch.tensor([np.cos(angle), np.sin(angle)])
        centre = torch.from_numpy(rng.uniform(7, 9, 2))
        inside = ((x - centre[0]) * normal[0] + (y - centre[1]) * normal[1] <= 0).double()
        exact = inside.reshape(side, 16, side, 16).mean((1, 3))
        tangent = torch.stack((-normal[1], normal[0]))
        corners = torch.stack((centre - 60 * tangent, centre + 60 * tangent, centre - 60 * normal))
        clip = torch.cat((corners * 2 / side - 1, torch.tensor([[0.0, 1]]).expand(3, 2)), 1)
        image = paint(clip, torch.tensor([[0, 1, 2]], dtype=torch.int32), side, side, backend)
        error = (image.double() - exact)[1:-1, 1:-1].abs()
        assert float(error.max()) < 0.14  # An edge at 45 degrees through pixel corners has a coverage error of 1/8.


@pytest.mark.parametrize("backend", BACKENDS)
def test_gradient_equals_the_change_of_the_covered_area(backend: str, rng: np.random.Generator) -> None:
    """Catches a gradient of wrong sign or size. The sum of a white rectangle's pixels is its area."""
    x0, y0, x1, y1 = 2.3, 1.8, 8.6, 8.1
    pos = rectangle(x0, y0, x1, y1, HEIGHT, WIDTH).float()[None].requires_grad_()
    rast = rasterize_brute_force(pos, RECTANGLE, HEIGHT, WIDTH)
    color = (rast[..., 3:] > 0).float()
    area = antialias(color, rast, pos, RECTANGLE, backend=backend).sum()  # type: ignore[arg-type]
    (gradient,) = torch.autograd.grad(area, pos)
    to_px = gradient[0, :, :2] / torch.tensor([WIDTH / 2, HEIGHT / 2])
    left, right = to_px[[0, 3], 0].sum(), to_px[[1, 2], 0].sum()
    top, bottom = to_px[[0, 1], 1].sum(), to_px[[2, 3], 1].sum()
    # A moving edge changes only pixels whose centres lie between the two adjacent edges: 6 rows for a vertical edge, 7
    # columns for a horizontal edge. In one of the 7 columns, the pixel shows the triangle that does not contain the
    # horizontal edge.
    expected = torch.tensor([-6.0, 6.0, -6.0, 6.0])
    torch.testing.assert_close(torch.stack((left, right, top, bottom)), expected, rtol=1e-4, atol=1e-4)
    assert not gradient[..., 2].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_edges_inside_a_surface_are_not_blended(backend: str) -> None:
    """Catches blending at the common edge of the two triangles of a rectangle. The triangles have different colours."""
    pos = rectangle(2.3, 1.8, 8.6, 6.4, HEIGHT, WIDTH).float()[None]
    rast = rasterize_brute_force(pos, RECTANGLE, HEIGHT, WIDTH)
    color = rast[..., 3:].clone()
    found = antialias(color, rast, pos, RECTANGLE, backend=backend)  # type: ignore[arg-type]
    inside = (slice(None), slice(2, 6), slice(3, 8))
    assert len(color[inside].unique()) == 2
    assert torch.equal(found[inside], color[inside])


@pytest.mark.parametrize("backend", BACKENDS)
def test_folds_are_silhouettes(backend: str) -> None:
    """Catches an edge of two triangles that is not blended although both triangles lie on the left of the edge."""
    pos = torch.cat((rectangle(2.3, 1.0, 8.6, 8.0, HEIGHT, WIDTH), rectangle(3.0, 1.0, 8.6, 8.0, HEIGHT, WIDTH, 0.5)))
    tri = torch.tensor([[0, 1, 2], [0, 2, 3], [4, 1, 2]], dtype=torch.int32)
    image = paint(pos, tri, HEIGHT, WIDTH, backend)
    torch.testing.assert_close(image[2:7, 8], torch.full((5,), 0.6), rtol=0, atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_nearer_surface_owns_the_edge(backend: str) -> None:
    """Catches a far edge that is blended although a nearer surface hides it, and a reversed comparison of depths."""
    far = rectangle(0.0, 0.0, 12.0, 9.0, HEIGHT, WIDTH, 0.5)
    near = rectangle(2.3, 1.8, 8.6, 6.4, HEIGHT, WIDTH, 0.1)
    pos = torch.cat((far, near))[None].float()
    tri = torch.cat((RECTANGLE, RECTANGLE + 4))
    rast = rasterize_brute_force(pos, tri, HEIGHT, WIDTH)
    color = (rast[..., 3:] > 2.5).float()
    image = antialias(color, rast, pos, tri, backend=backend)[0, ..., 0]  # type: ignore[arg-type]
    torch.testing.assert_close(image[3, 2:9], torch.tensor([0.7, 1, 1, 1, 1, 1, 0.6]), rtol=0, atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_triangles_that_cross_the_camera_plane_are_blended(backend: str) -> None:
    """Catches divisions by w of a vertex behind the camera, which mirror the edge. The floor ends at x = 0.05 w."""
    w = torch.tensor([4.0, -2.0, 4.0])
    pos = torch.stack((torch.tensor([0.2, -0.1, -20.0]), torch.full((3,), -1.0), w - 0.8, w), 1)[None]
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    rast = rasterize_brute_force(pos, tri, HEIGHT, WIDTH)
    color = (rast[..., 3:] > 0).float()
    image = antialias(color, rast, pos, tri, backend=backend)[0, ..., 0].double()  # type: ignore[arg-type]
    rows = color[0, :, 0, 0] > 0
    assert rows.sum() == 3
    expected = covered(0, (0.05 + 1) / 2 * WIDTH, WIDTH)
    torch.testing.assert_close(image[rows], expected.expand(3, WIDTH), rtol=0, atol=1e-5)


def test_topology_of_a_closed_mesh_and_of_a_strip() -> None:
    """Catches neighbours that depend on the order of an edge's vertices, and open edges that get a neighbour."""
    tetrahedron = torch.tensor([[0, 1, 2], [0, 1, 3], [2, 0, 3], [3, 2, 1]], dtype=torch.int32)
    assert opposite_vertices(tetrahedron).tolist() == [[3, 3, 3], [2, 2, 2], [1, 1, 1], [0, 0, 0]]
    strip = torch.tensor([[0, 1, 2], [1, 2, 3]], dtype=torch.int32)
    assert opposite_vertices(strip).tolist() == [[3, -1, -1], [-1, -1, 0]]
    assert opposite_vertices(strip[:0]).shape == (0, 3)
