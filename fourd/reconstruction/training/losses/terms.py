"""List the loss terms of each kind of scene."""

from __future__ import annotations

from fourd.reconstruction.training.background import StaticBackground
from fourd.reconstruction.training.cameras.refinement import Refinement
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.losses.background_opacity import BackgroundOpacityTerm
from fourd.reconstruction.training.losses.high_sh import HighShTerm
from fourd.reconstruction.training.losses.image import ImageTerm
from fourd.reconstruction.training.losses.lpips import LPIPS
from fourd.reconstruction.training.losses.mask import MaskTerm
from fourd.reconstruction.training.losses.perceptual import PerceptualTerm
from fourd.reconstruction.training.losses.refinement import RefinementTerm
from fourd.reconstruction.training.losses.residual import ResidualTerm
from fourd.reconstruction.training.losses.shadow import ShadowTerm
from fourd.reconstruction.training.losses.similarity import SimilarityTerm
from fourd.reconstruction.training.losses.term import LossTerm


def common_terms(
    config: TrainConfig, spacing: float, lpips: LPIPS | None, refinement: Refinement | None
) -> tuple[LossTerm, ...]:
    """List the loss terms that are used in every scene. Add new terms at the end, because the terms' order determines
    the order in which gradients are summed, and another order changes the rounding errors.

    Args:
        config: training config of the run.
        spacing: mean distance between neighbouring foreground points in world units.
        lpips: network of the perceptual term; if None, SSIM replaces the perceptual term.
        refinement: camera corrections, or None if no corrections are learnt.
    """
    weights = config.loss
    terms: list[LossTerm] = [ImageTerm(weights.image)]
    terms.append(SimilarityTerm(weights.stand_in) if lpips is None else PerceptualTerm(weights.perceptual, lpips))
    terms.append(MaskTerm(weights.mask))
    terms.append(ResidualTerm(weights.residual, spacing))
    if refinement is not None:
        terms.append(RefinementTerm(config.refine.weight, refinement))
    if config.model.appearance == "both":
        terms.append(HighShTerm(weights.high_sh))
    return _enabled(terms)


def full_scene_terms(config: TrainConfig, background: StaticBackground) -> tuple[LossTerm, ...]:
    """List the additional loss terms of a full scene, which follow the common terms in the sum."""
    terms: list[LossTerm] = []
    if config.background.joint and background.model.shadow is not None:
        terms.append(ShadowTerm(config.loss.shadow, background, background.model.shadow))
    terms.append(BackgroundOpacityTerm(config.loss.closed, background, config))
    return _enabled(terms)


def _enabled(terms: list[LossTerm]) -> tuple[LossTerm, ...]:
    return tuple(term for term in terms if term.weight > 0)
