"""Separate triangles of one colour each: their parameters and their rendering."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.meshes.triangle_fitting.adam import AdamRows
from fourd.reconstruction.meshes.triangle_fitting.schedule import Phase
from fourd.rendering.triangles import TriangleRender, splat_triangles

START_OPACITY = 0.28
CIRCUMRADIUS_SPACINGS = 1.5
"""Circumradius of the initial triangles, as a multiple of the distance between neighbouring triangles' centres."""
POSITION_RATE_SPACINGS = 0.02
COLOUR_RATE = 0.01
OPACITY_RATE = 0.05


class Soup:
    """T triangles without shared vertices.

    Attributes:
        corners: (T, 3, 3) vertices in world units.
        colours: (T, 3) RGB, where 0 is black and 1 is white.
        logits: (T,) opacity parameters. :meth:`opacity` converts them to opacities.
        spacing: initial distance between neighbouring triangles in world units, to which the learning rate of positions
            is proportional.
    """

    def __init__(self, corners: Tensor, colours: Tensor, spacing: float) -> None:
        """Start with the given corners (T, 3, 3) and colours (T, 3)."""
        self.spacing = spacing
        start = torch.full((len(corners),), START_OPACITY)
        self.corners = AdamRows(corners, POSITION_RATE_SPACINGS * spacing)
        self.colours = AdamRows(colours, COLOUR_RATE)
        self.logits = AdamRows(torch.logit(start), OPACITY_RATE)

    def __len__(self) -> int:
        return len(self.corners.value)

    def opacity(self, floor: float) -> Tensor:
        """Return the opacities (T,): the sigmoids of the logits, scaled to the range from ``floor`` to 1."""
        return floor + (1 - floor) * torch.sigmoid(self.logits.value)

    def render(self, camera: Camera, phase: Phase) -> TriangleRender:
        """Render the triangles on a black background. The result is differentiable with respect to all parameters."""
        return splat_triangles(
            self.corners.value.reshape(-1, 3),
            triangle_indices(len(self)),
            self.colours.value,
            self.opacity(phase.floor),
            phase.sigma,
            camera,
            geometry=False,
        )

    def step(self, loss: Tensor, phase: Phase) -> Tensor:
        """Update all parameters with one optimizer step. Return the gradient (T, 3, 3) of ``loss`` with respect to the
        corners."""
        rows = (self.corners, self.colours, self.logits)
        gradients = torch.autograd.grad(loss, [each.value for each in rows], materialize_grads=True)
        for each, gradient, factor in zip(rows, gradients, (phase.rate, 1.0, 1.0), strict=True):
            each.step(gradient, factor)
        return gradients[0]


def triangle_indices(count: int) -> Tensor:
    """Return the int32 vertex indices (T, 3) of triangles without shared vertices."""
    return torch.arange(3 * count, dtype=torch.int32).reshape(count, 3)


def start_triangles(
    xyz: NDArray[np.float32], normals: NDArray[np.float32], spacing: float, generator: torch.Generator
) -> Tensor:
    """Return equilateral triangles (N, 3, 3) that are centred on surface points, lie in the tangent planes, and are
    rotated by random angles about their normals.

    Args:
        xyz: (N, 3) points.
        normals: (N, 3) outward unit normals. The triangles are counter-clockwise seen from outside.
        spacing: distance between neighbouring points.
        generator: random generator for the rotations.
    """
    centres, normal = torch.from_numpy(xyz), torch.from_numpy(normals)
    random = torch.randn(len(xyz), 3, generator=generator)
    across = torch.nn.functional.normalize(torch.linalg.cross(random, normal), dim=1)
    along = torch.linalg.cross(normal, across)
    angles = torch.tensor([0.0, 2.0, 4.0]) * torch.pi / 3
    offsets = torch.cos(angles)[:, None] * across[:, None] + torch.sin(angles)[:, None] * along[:, None]
    return centres[:, None] + CIRCUMRADIUS_SPACINGS * spacing * offsets
