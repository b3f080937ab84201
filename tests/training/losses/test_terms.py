"""Loss terms compared with plain formulas, and the lists of loss terms for different configs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from fourd.reconstruction.model.config import ModelConfig
from fourd.reconstruction.training.config import LossConfig, TrainConfig
from fourd.reconstruction.training.evaluation.metrics import ssim
from fourd.reconstruction.training.losses.high_sh import HighShTerm
from fourd.reconstruction.training.losses.image import ImageTerm
from fourd.reconstruction.training.losses.lpips import LPIPS, expected_shapes
from fourd.reconstruction.training.losses.mask import MaskTerm
from fourd.reconstruction.training.losses.residual import ResidualTerm
from fourd.reconstruction.training.losses.similarity import SimilarityTerm
from fourd.reconstruction.training.losses.term import RenderedStep, term_values
from fourd.reconstruction.training.losses.terms import common_terms
from fourd.reconstruction.training.schedule import StepSample
from fourd.reconstruction.training.step import set_gradients

SAMPLE = StepSample(0, 0, [1], np.ones(1, np.float32), np.zeros(3, np.float32), 8)


def rendered(side: int = 16) -> RenderedStep:
    generator = torch.Generator().manual_seed(0)
    prediction, truth = torch.rand(2, side, side, 3, generator=generator)
    coverage, matte = torch.rand(2, side, side, generator=generator)
    displacement = torch.rand(5, 3, generator=generator)
    sh = torch.rand(5, 3, 16, generator=generator, requires_grad=True)
    return RenderedStep(0, 0.0, SAMPLE, prediction, truth, coverage, matte, sh, displacement)


def test_terms_equal_their_formulas() -> None:
    """Catches a loss term that compares the wrong images, or is not divided by its unit."""
    step = rendered()
    assert step.matte is not None
    assert step.displacement is not None
    assert step.sh is not None
    difference = (step.prediction - step.truth).abs()
    huber = torch.where(difference < 0.1, difference.square() / 2, 0.1 * (difference - 0.05))
    expected = {
        ImageTerm("mse"): difference.square().mean(),
        ImageTerm("huber"): huber.mean(),
        SimilarityTerm(1.0): 1 - ssim(step.prediction, step.truth),
        MaskTerm(1.0): (step.coverage - step.matte).square().mean(),
        ResidualTerm(1.0, 0.1): (step.displacement / 0.1).square().mean(),
        HighShTerm(1.0): step.sh[:, :, 4:].square().sum() / (5 * 3 * 12),
    }
    for term, value in expected.items():
        torch.testing.assert_close(term.value(step), value, rtol=1e-5, atol=1e-6)


def test_terms_need_what_they_compare() -> None:
    """Catches a crash of a loss term for plates (which have no matte), for models without displacement, and for small
    images."""
    step = replace(rendered(side=10), matte=None, sh=None, displacement=None)
    terms = (ImageTerm("mse"), SimilarityTerm(1.0), MaskTerm(1.0), ResidualTerm(1.0, 0.1), HighShTerm(1.0))
    assert list(term_values(terms, step)) == ["image"]


def test_high_sh_term_leaves_low_degrees_alone() -> None:
    """Catches a penalty on the degrees 0 and 1, and a loss term for models whose whole colour comes from SH."""
    step = rendered()
    assert step.sh is not None
    HighShTerm(1.0).value(step).backward()
    torch.testing.assert_close(step.sh.grad[:, :, 4:], 2 * step.sh.detach()[:, :, 4:] / (5 * 3 * 12))
    assert not step.sh.grad[:, :, :4].any()
    only_sh = TrainConfig(model=ModelConfig(appearance="sh"))
    assert "high_sh" not in [term.name for term in common_terms(only_sh, 0.1, None, None)]


def test_terms_are_finite_if_no_point_is_visible() -> None:
    """Catches a training run that stops with NaN because the background occludes the whole foreground in one view."""
    step = replace(rendered(), sh=torch.zeros(0, 3, 16), displacement=torch.zeros(0, 3))
    terms = (ImageTerm("mse"), MaskTerm(1.0), ResidualTerm(1.0, 0.1), HighShTerm(1.0))
    values = term_values(terms, step)
    assert list(values) == ["image", "mask"]
    assert all(value.isfinite() for value in values.values())


def test_gradients_are_those_of_the_weighted_sum() -> None:
    """Catches a weight of a loss term that is ignored or applied twice, and a term without a gradient that stops a
    step."""
    leaf, unused = torch.tensor([2.0, 3.0], requires_grad=True), torch.tensor(1.0, requires_grad=True)
    terms = [leaf.square().sum(), torch.tensor(5.0), leaf.prod()]
    set_gradients(terms, list(torch.tensor([0.5, 9.0, 10.0])), [leaf, unused, torch.tensor(1.0)])
    assert leaf.grad is not None
    assert leaf.grad.tolist() == pytest.approx([2 + 30, 3 + 20])
    assert unused.grad is None


def test_weight_zero_switches_a_term_off() -> None:
    """Catches loss terms with weight 0 that are computed."""
    config = TrainConfig(loss=LossConfig(stand_in=0, mask=0, high_sh=0))
    assert [term.name for term in common_terms(config, 0.1, None, None)] == ["image", "residual"]


def test_lpips_replaces_ssim() -> None:
    """Catches a loss that contains both LPIPS and SSIM, or neither of them."""
    network = LPIPS({name: torch.zeros(shape) for name, shape in expected_shapes().items()})
    with_network = [term.name for term in common_terms(TrainConfig(), 0.1, network, None)]
    without = [term.name for term in common_terms(TrainConfig(), 0.1, None, None)]
    assert with_network == ["image", "lpips", "mask", "residual", "high_sh"]
    assert without == ["image", "ssim", "mask", "residual", "high_sh"]
