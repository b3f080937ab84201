"""The fit of separate triangles, which gradually become opaque."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from fourd.reconstruction.meshes.triangle_fitting.growth import prune_and_grow
from fourd.reconstruction.meshes.triangle_fitting.neighbours import Neighbours, smoothness_loss
from fourd.reconstruction.meshes.triangle_fitting.schedule import Phase
from fourd.reconstruction.meshes.triangle_fitting.settings import TriangleSettings
from fourd.reconstruction.meshes.triangle_fitting.soup import Soup
from fourd.reconstruction.meshes.triangle_fitting.targets import Target, TargetOrder

NEIGHBOUR_STEPS = 50
"""Number of steps after which the triangles' neighbours are searched again."""


class SoftFit:
    """Fits soft triangles to the views of one frame by triangle splatting (Held et al. 2025).

    Attributes:
        soup: the triangles, which are changed in place.
    """

    def __init__(
        self, soup: Soup, targets: Sequence[Target], settings: TriangleSettings, generator: torch.Generator
    ) -> None:
        """Start a fit of ``soup`` to one or more targets."""
        self.soup = soup
        self._order = TargetOrder(targets, generator)
        self._cameras = [target.camera for target in targets]
        self._settings, self._generator = settings, generator
        self._steps = 0
        self._neighbours = Neighbours.of(soup.corners.value.detach())
        self._reset_statistics()

    def step(self, phase: Phase) -> None:
        """Perform one optimization step: render one view, and update all triangles."""
        if self._steps % NEIGHBOUR_STEPS == 0:
            self._neighbours = Neighbours.of(self.soup.corners.value.detach())
        target = self._order.draw()
        image = self.soup.render(target.camera, phase)
        gradient = self.soup.step(target.loss(image.features, image.alpha) + self._smoothness(), phase)
        self._steps += 1
        if not phase.grows:
            return
        torch.maximum(self._weights, image.weight.detach(), out=self._weights)
        self._priority += gradient.flatten(1).norm(dim=1)
        if self._steps % self._settings.interval == 0:
            priority = self._priority * self.soup.opacity(0.0).detach()
            most = self._settings.triangles
            prune_and_grow(self.soup, self._weights, priority, self._cameras, most, self._generator)
            self._neighbours = Neighbours.of(self.soup.corners.value.detach())
            self._reset_statistics()

    def _smoothness(self) -> Tensor:
        plane, normal = smoothness_loss(self.soup.corners.value, self._neighbours, self.soup.spacing)
        return self._settings.plane * plane + self._settings.normal * normal

    def _reset_statistics(self) -> None:
        self._weights = torch.zeros(len(self.soup))
        self._priority = torch.zeros(len(self.soup))
