"""The fit of opaque triangles, which either have been joined into a mesh or are still separate."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from fourd.reconstruction.meshes.surface.losses import MeshTopology, laplacian_loss, normal_consistency_loss
from fourd.reconstruction.meshes.triangle_fitting.adam import AdamRows
from fourd.reconstruction.meshes.triangle_fitting.neighbours import Neighbours, smoothness_loss
from fourd.reconstruction.meshes.triangle_fitting.opaque import ColouredMesh, render_opaque
from fourd.reconstruction.meshes.triangle_fitting.settings import TriangleSettings
from fourd.reconstruction.meshes.triangle_fitting.soft import NEIGHBOUR_STEPS
from fourd.reconstruction.meshes.triangle_fitting.targets import Target, TargetOrder
from fourd.rendering.triangles import antialias_construct_topology

POSITION_RATE = 0.02
"""Learning rate of vertex positions, as a multiple of ``side``, the length that is the mesh's resolution."""
COLOUR_RATE = 0.01


class SurfaceFit:
    """Fits the vertex positions and colours of an opaque mesh to the views of one frame, by rasterization with
    antialiasing.

    Attributes:
        tri: (M, 3) int32 vertex indices.
        xyz: (V, 3) vertices in world units.
        rgb: (V, 3) colours.
    """

    def __init__(
        self,
        mesh: tuple[Tensor, Tensor, Tensor],
        side: float,
        targets: Sequence[Target],
        settings: TriangleSettings,
        generator: torch.Generator,
    ) -> None:
        """Start with a mesh, given as vertices (V, 3), colours (V, 3) and triangles (M, 3). ``side`` is a length in
        world units: for a joined mesh, the side of the grid cells from which it was extracted; for separate triangles,
        the initial distance between neighbouring triangles."""
        xyz, rgb, self.tri = mesh
        self.xyz, self.rgb = AdamRows(xyz, POSITION_RATE * side), AdamRows(rgb, COLOUR_RATE)
        self._side, self._settings = side, settings
        self._order = TargetOrder(targets, generator)
        self._edges = antialias_construct_topology(self.tri)
        self._topology = MeshTopology.of(self.tri.long(), len(xyz)) if settings.connect else None
        self._neighbours: Neighbours | None = None
        self._steps = 0

    def step(self, rate: float) -> None:
        """Perform one optimization step on one view, with learning rates multiplied by ``rate``."""
        target = self._order.draw()
        image, alpha = render_opaque(self.xyz.value, self.rgb.value, self.tri, target.camera, self._edges)
        loss = target.loss(image, alpha) + self._smoothness()
        gradients = torch.autograd.grad(loss, [self.xyz.value, self.rgb.value])
        for rows, gradient in zip((self.xyz, self.rgb), gradients, strict=True):
            rows.step(gradient, rate)
        self._steps += 1

    @torch.no_grad()
    def mesh(self) -> ColouredMesh:
        """Return the mesh for the current parameters."""
        rgb = (self.rgb.value.clamp(0, 1) * 255).round().to(torch.uint8)
        return ColouredMesh(self.xyz.value.detach().numpy().copy(), self.tri.numpy(), rgb.numpy())

    def _smoothness(self) -> Tensor:
        settings = self._settings
        if self._topology is not None:
            laplacian = laplacian_loss(self.xyz.value / self._side, self._topology)
            crease = normal_consistency_loss(self.xyz.value, self.tri.long(), self._topology)
            return settings.laplacian * laplacian + settings.crease * crease
        corners = self.xyz.value.reshape(-1, 3, 3)
        if self._neighbours is None or self._steps % NEIGHBOUR_STEPS == 0:
            self._neighbours = Neighbours.of(corners.detach())
        plane, normal = smoothness_loss(corners, self._neighbours, self._side)
        return settings.plane * plane + settings.normal * normal
