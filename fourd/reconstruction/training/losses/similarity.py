"""Similarity term: 1 - SSIM. It replaces LPIPS if the LPIPS weights are missing."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.reconstruction.training.losses.term import RenderedStep
from fourd.rendering.ops.similarity.op import structural_similarity

WINDOW_PX = 11


@dataclass(frozen=True)
class SimilarityTerm:
    """1 - SSIM. The term applies to images that are at least as large as the SSIM window."""

    weight: float
    name: str = "ssim"

    def applies_to(self, step: RenderedStep) -> bool:
        return min(step.truth.shape[:2]) >= WINDOW_PX

    def value(self, step: RenderedStep) -> Tensor:
        return 1 - structural_similarity(step.prediction, step.truth)
