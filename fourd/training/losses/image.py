"""The loss: image, perceptual or its stand-in, and mask terms (4K4D, eq. 8)."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional

from fourd.ops.similarity.op import structural_similarity
from fourd.training.config import LossConfig
from fourd.training.losses.lpips import LPIPS


class ImageLoss:
    """Compares a rendered picture with the truth."""

    def __init__(self, config: LossConfig, lpips: LPIPS | None) -> None:
        """``lpips`` is the published network, or None to use the stand-in 1 - SSIM."""
        self.config = config
        self.lpips = lpips

    def terms(
        self, predicted: Tensor, truth: Tensor, coverage: Tensor | None, matte: Tensor | None
    ) -> dict[str, Tensor]:
        """Weighted terms by name, each a scalar.

        Args:
            predicted, truth: (H, W, 3) whole pictures, on the same colour where they have nothing of their own.
            coverage, matte: (H, W) in [0, 1], what moves as rendered and in truth; None where nothing is known of it.
        """
        terms = {"image": self._image(predicted, truth)}
        if self.lpips is not None and self.config.perceptual > 0:
            terms["lpips"] = self.config.perceptual * self.lpips(predicted, truth)
        elif self.lpips is None and self.config.stand_in > 0 and min(truth.shape[:2]) >= 11:
            terms["ssim"] = self.config.stand_in * (1 - structural_similarity(predicted, truth))
        if self.config.mask > 0 and coverage is not None and matte is not None:
            terms["mask"] = self.config.mask * functional.mse_loss(coverage, matte)
        return terms

    def _image(self, predicted: Tensor, truth: Tensor) -> Tensor:
        if self.config.image == "huber":
            return functional.huber_loss(predicted, truth, delta=0.1)
        return functional.mse_loss(predicted, truth)
