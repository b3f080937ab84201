"""The public function rasterize_soft: known values and error messages."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from fourd.rendering.ops.points.validation import pack_camera
from fourd.rendering.triangles import rasterize_soft
from tests.raster.clouds import turned_camera
from tests.raster.triangles.test_splatting import front_camera

BACKENDS = ("cpu", "reference")


@pytest.mark.parametrize("backend", BACKENDS)
def test_silhouette_of_a_right_triangle(backend: Any) -> None:
    """Catches an alpha that is not sigmoid(+-d^2 / sigma). The unit of d is half of the image's side."""
    side, sigma = 32, 1e-2
    # Corners at the pixel coordinates (8, 8), (24, 8) and (8, 24).
    xyz = torch.tensor([[-0.25, -0.25, 0], [0.25, -0.25, 0], [-0.25, 0.25, 0]])
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    alpha = rasterize_soft(xyz, tri, torch.ones(1, 1), front_camera(side), sigma=sigma, backend=backend)[1]
    for row, column in [(10, 12), (12, 10), (9, 9), (12, 12)]:
        x, y = column + 0.5, row + 0.5
        distance = min(x - 8, y - 8, (32 - x - y) / math.sqrt(2)) * 2 / side
        assert float(alpha[row, column]) == pytest.approx(1 / (1 + math.exp(-(distance**2) / sigma)), abs=1e-5)
    for row, column, distance in [(6, 12, 1.5), (12, 4, 3.5), (5, 6, math.hypot(2.5, 1.5))]:
        expected = 1 / (1 + math.exp((distance * 2 / side) ** 2 / sigma))
        assert float(alpha[row, column]) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_nearer_triangles_outweigh_farther_ones(backend: Any) -> None:
    """Catches a depth softmax that prefers far triangles, or that ignores gamma and the background."""
    corners = torch.tensor([[-0.4, -0.4, 0.0], [0.4, -0.4, 0.0], [0.0, 0.6, 0.0]])
    xyz = torch.cat([corners + torch.tensor([0, 0, 0.5]), corners])
    tri = torch.tensor([[0, 1, 2], [3, 4, 5]], dtype=torch.int32)
    colours = torch.eye(2)
    for gamma in (0.05, 0.5):
        image, _ = rasterize_soft(
            xyz, tri, colours, front_camera(16), gamma=gamma, far=10.01, backend=backend, sigma=1e-4
        )
        near, far = (math.exp((10.01 - depth) / 10 / gamma) for depth in (1.0, 1.5))
        total = near + far + math.exp(1e-3 / gamma)
        torch.testing.assert_close(image[8, 8], torch.tensor([far, near]) / total, atol=1e-3, rtol=0)


def arguments() -> dict[str, Any]:
    return {
        "xyz": torch.rand(6, 3),
        "tri": torch.tensor([[0, 1, 2], [3, 4, 5]], dtype=torch.int32),
        "features": torch.rand(2, 3),
        "camera": turned_camera(8, 8),
    }


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"xyz": None}, TypeError, "xyz: expected a torch.Tensor, got NoneType"),
        ({"tri": torch.tensor([[0, 1, 6]] * 2).int()}, ValueError, "tri: expected vertex indices from 0 to 5, got 6"),
        ({"features": torch.rand(3, 3)}, ValueError, r"features: expected shape \(2, C\), got \(3, 3\)"),
        ({"features": torch.rand(2, 33)}, ValueError, "features: expected 1 to 32 channels, got 33"),
        ({"sigma": 0.0}, ValueError, "sigma: expected a finite number above 0, got 0.0"),
        ({"gamma": -1.0}, ValueError, "gamma: expected a finite number above 0, got -1.0"),
        ({"layers": 0}, ValueError, "layers: expected 1 to 1048576, got 0"),
        ({"distance": "hard"}, ValueError, "distance: expected 'euclidean' or 'barycentric', got 'hard'"),
        ({"cutoff": 0.5}, ValueError, "cutoff: expected a number above 0 and below 0.5, got 0.5"),
        ({"far": 0.001}, ValueError, "far: expected a finite distance above near = 0.01, got 0.001"),
        ({"eps": 1.0}, ValueError, "eps: expected a number from 0 to below 1, got 1.0"),
    ],
)
def test_messages(changes: dict[str, Any], error: type[Exception], message: str) -> None:
    """Catches an invalid argument that reaches a kernel, and a message that does not name it."""
    with pytest.raises(error, match=message):
        rasterize_soft(**{**arguments(), **changes})


@pytest.mark.parametrize("vertex", [-1, 6])
def test_the_operators_check_vertex_indices(vertex: int) -> None:
    """Catches reads past the end of the positions, if a caller does not use fourd.rendering."""
    xyz, tri, features = torch.rand(6, 3), torch.tensor([[0, 1, vertex]]).int(), torch.rand(1, 3)
    camera, softness = pack_camera(turned_camera(8, 8)), [0, 1e-4, 1e-2, 1e-3, 0.1, 10, 1e-3]
    with pytest.raises(ValueError, match="tri: expected indices of vertices"):
        torch.ops.fourd.rasterize_soft(xyz, tri, features, camera, 8, 8, softness, 4, 0)
    one = torch.rand(1)
    with pytest.raises(ValueError, match="tri: expected indices of vertices"):
        torch.ops.fourd.splat_triangles(xyz, tri, features, one, one, False, camera, 8, 8, 4, 0.01, 0)
