"""The public function splat_triangles: known values and error messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch

from fourd.base.cameras import Camera
from fourd.rendering.triangles import splat_triangles
from tests.raster.clouds import turned_camera

BACKENDS = ("cpu", "reference")


def front_camera(side: int) -> Camera:
    """Return a camera at distance 1 from the plane z = 0, in which a pixel is 1 / side world units."""
    intrinsics = np.array([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1.0]])
    return Camera(intrinsics, np.eye(3), np.array([0.0, 0.0, 1.0]), side, side)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.0])
def test_window_of_a_right_triangle(backend: Any, sigma: float) -> None:
    """Catches a window that is not (distance from the nearest edge / inradius)^sigma."""
    side = 32
    # Corners at the pixel coordinates (0, 0), (32, 0) and (0, 32).
    xyz = torch.tensor([[-0.5, -0.5, 0], [0.5, -0.5, 0], [-0.5, 0.5, 0]])
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    image = splat_triangles(
        xyz, tri, torch.tensor([[1.0]]), torch.tensor([0.8]), sigma, front_camera(side), backend=backend
    )
    inradius = side * (2 - math.sqrt(2)) / 2
    for row, column in [(4, 9), (9, 4), (15, 15), (8, 8), (2, 2), (10, 17)]:
        x, y = column + 0.5, row + 0.5
        distance = min(x, y, (side - x - y) / math.sqrt(2))
        expected = 0.8 * max(distance / inradius, 0) ** sigma
        expected = expected if expected >= 1 / 255 else 0
        assert float(image.alpha[row, column]) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_depth_and_normal_of_one_triangle(backend: Any) -> None:
    """Catches a depth that is not divided by alpha, and a normal that points away from the camera."""
    xyz = torch.tensor([[-0.5, -0.5, 1.0], [0.5, -0.5, 1.0], [-0.5, 0.9, 2.5]])
    for corners in ([0, 1, 2], [0, 2, 1]):
        tri = torch.tensor([corners], dtype=torch.int32)
        image = splat_triangles(xyz, tri, torch.ones(1, 1), torch.tensor([0.5]), 1.0, front_camera(32), backend=backend)
        assert image.depth is not None
        assert image.normal is not None
        seen = image.alpha > 0
        assert int(seen.sum()) > 20
        torch.testing.assert_close(image.depth[seen], torch.full_like(image.depth[seen], 2.5))
        normal = torch.tensor([0.0, 1.5, -1.4]) / math.hypot(1.5, 1.4)
        torch.testing.assert_close(image.normal[seen], image.alpha[seen][:, None] * normal, atol=1e-5, rtol=0)


def arguments() -> dict[str, Any]:
    return {
        "xyz": torch.rand(6, 3),
        "tri": torch.tensor([[0, 1, 2], [3, 4, 5]], dtype=torch.int32),
        "features": torch.rand(2, 3),
        "opacity": torch.rand(2),
        "sigma": torch.rand(2),
        "camera": turned_camera(8, 8),
    }


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"xyz": [1, 2]}, TypeError, "xyz: expected a torch.Tensor, got list"),
        ({"xyz": torch.rand(6, 2)}, ValueError, r"xyz: expected shape \(V, 3\), got \(6, 2\)"),
        ({"xyz": torch.rand(6, 3).double()}, TypeError, "xyz: expected dtype float32, got float64"),
        ({"tri": torch.tensor([[0, 1, 6]] * 2).int()}, ValueError, "tri: expected vertex indices from 0 to 5, got 6"),
        ({"tri": torch.tensor([[0, -1, 2]] * 2).int()}, ValueError, "tri: expected vertex indices from 0 to 5, got -1"),
        ({"tri": torch.tensor([[0, 1, 2]] * 2)}, TypeError, "tri: expected dtype int32, got int64; use tri.int"),
        ({"features": torch.rand(3, 3)}, ValueError, r"features: expected shape \(2, C\), got \(3, 3\)"),
        ({"features": torch.rand(2, 33)}, ValueError, "features: expected 1 to 32 channels, got 33"),
        ({"opacity": torch.rand(3)}, ValueError, r"opacity: expected shape \(2,\), got \(3,\)"),
        ({"sigma": "soft"}, TypeError, "sigma: expected a torch.Tensor or a number, got str"),
        ({"sigma": 0.0}, ValueError, "sigma: expected a finite number above 0, got 0.0"),
        ({"layers": 0}, ValueError, "layers: expected 1 to 1048576, got 0"),
        ({"layers": 2.5}, TypeError, "layers: expected an integer or None, got float"),
        ({"near": 0.0}, ValueError, "near: expected a finite distance above 0, got 0.0"),
        ({"camera": None}, TypeError, "camera: expected a fourd.Camera, got NoneType"),
        ({"backend": "fast"}, ValueError, "backend: expected 'auto', 'reference', 'cpu' or 'cuda', got 'fast'"),
    ],
)
def test_messages(changes: dict[str, Any], error: type[Exception], message: str) -> None:
    """Catches an invalid argument that reaches a kernel, and a message that does not name it."""
    with pytest.raises(error, match=message):
        splat_triangles(**{**arguments(), **changes})
