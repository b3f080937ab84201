"""The loss: image, perceptual or its stand-in, and mask terms (4K4D, eq. 8)."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional

from fourd.training.config import LossConfig
from fourd.training.lpips import LPIPS
from fourd.training.similarity import similarity


class ImageLoss:
    """Compares a rendered object with the truth on a common background."""

    def __init__(self, config: LossConfig, lpips: LPIPS | None) -> None:
        """``lpips`` is the published network, or None to use the stand-in 1 - SSIM."""
        self.config = config
        self.lpips = lpips

    def terms(
        self, colour: Tensor, alpha: Tensor, target: Tensor, matte: Tensor, background: Tensor
    ) -> dict[str, Tensor]:
        """Weighted terms by name, each a scalar.

        Args:
            colour: (H, W, 3) rendered, premultiplied by alpha.
            alpha: (H, W) rendered coverage.
            target: (H, W, 3) truth, premultiplied by the matte.
            matte: (H, W) in [0, 1].
            background: (3,) colour that both are put on.
        """
        predicted = colour + (1 - alpha)[..., None] * background
        truth = target + (1 - matte)[..., None] * background
        terms = {"image": self._image(predicted, truth)}
        if self.lpips is not None and self.config.perceptual > 0:
            terms["lpips"] = self.config.perceptual * self.lpips(predicted, truth)
        elif self.lpips is None and self.config.stand_in > 0 and min(matte.shape) >= 11:
            terms["ssim"] = self.config.stand_in * (1 - similarity(predicted, truth))
        if self.config.mask > 0:
            terms["mask"] = self.config.mask * functional.mse_loss(alpha, matte)
        return terms

    def _image(self, predicted: Tensor, truth: Tensor) -> Tensor:
        if self.config.image == "huber":
            return functional.huber_loss(predicted, truth, delta=0.1)
        return functional.mse_loss(predicted, truth)
