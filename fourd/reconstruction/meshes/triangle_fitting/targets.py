"""Training views, and the loss of a rendered view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.meshes.views import MeshView
from fourd.rendering.ops.similarity.op import structural_similarity
from fourd.rendering.ops.similarity.reference import WINDOW_PX

SIMILARITY_WEIGHT = 0.2
MATTE_WEIGHT = 0.2


@dataclass(frozen=True, eq=False)
class Target:
    """A training view, cropped to the subject.

    Attributes:
        camera: pinhole camera of the crop.
        rgb: (H, W, 3) float32 image in [0, 1], black outside the subject.
        matte: (H, W) float32 matte in [0, 1].
    """

    camera: Camera
    rgb: Tensor
    matte: Tensor

    @staticmethod
    def of(view: MeshView) -> Target:
        """Convert a training view to a target of the fit."""
        matte = torch.from_numpy(view.matte)
        return Target(view.camera, torch.from_numpy(view.rgb) * matte[..., None], matte)

    def loss(self, rgb: Tensor, alpha: Tensor) -> Tensor:
        """Return the loss of a rendered image (H, W, 3) with a black background, and of its alpha (H, W). It is a
        weighted sum of the image's mean absolute error, the alpha's mean absolute error and, unless a side is shorter
        than WINDOW_PX, the image's structural dissimilarity."""
        colours, matte = (rgb - self.rgb).abs().mean(), (alpha - self.matte).abs().mean()
        loss = (1 - SIMILARITY_WEIGHT) * colours + MATTE_WEIGHT * matte
        if min(rgb.shape[:2]) < WINDOW_PX:
            return loss
        return loss + SIMILARITY_WEIGHT * (1 - structural_similarity(rgb, self.rgb))


class TargetOrder:
    """Selects targets in rounds. Each round contains every target once, in random order."""

    def __init__(self, targets: Sequence[Target], generator: torch.Generator) -> None:
        """Create an iterator over ``targets``, a list of at least one view. ``generator`` gives the random order."""
        self._targets, self._generator = targets, generator
        self._order: list[int] = []

    def draw(self) -> Target:
        """Return the next target."""
        if not self._order:
            self._order = torch.randperm(len(self._targets), generator=self._generator).tolist()
        return self._targets[self._order.pop()]
