"""Sampling of steps, and the schedule of learning rates."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from fourd.base.cameras import Camera, look_at, select_views
from fourd.reconstruction.model.config import ModelConfig
from fourd.reconstruction.training.config import RateConfig, TrainConfig
from fourd.reconstruction.training.schedule import StepSampler, budget_spent, rate_factor

INTRINSICS = np.array([[40.0, 0, 16], [0, 40, 16], [0, 0, 1]])


def ring(count: int) -> tuple[Camera, ...]:
    angles = np.arange(count) * 2 * np.pi / count
    up = np.array([0.0, 0, 1])
    centres = [np.array([3 * np.cos(a), 3 * np.sin(a), 0.5]) for a in angles]
    return tuple(look_at(centre, np.zeros(3), up, INTRINSICS, 32, 32) for centre in centres)


def sampler(seed: int = 3) -> StepSampler:
    return StepSampler(TrainConfig(seed=seed), ring(10), [0, 1, 2, 4, 5, 6, 7, 9], 5, np.zeros(3))


def test_held_out_views_and_the_target_are_never_sources() -> None:
    """Catches held-out views that are used in training, and a target view that is blended from itself."""
    for step in range(80):
        sample = sampler().sample(step)
        assert sample.target not in sample.sources
        assert sample.target not in (3, 8)
        assert not {3, 8} & set(sample.sources)
        assert len(set(sample.sources)) == 4


def test_source_weights_are_those_of_rendering() -> None:
    """Catches view weights in training that differ from those in rendering. In rendering, too, the target view is not a
    source view.
    """
    cameras, training = ring(10), [0, 1, 2, 4, 5, 6, 7, 9]
    config = TrainConfig(model=ModelConfig(fade_views=True))
    drawn = StepSampler(config, cameras, training, 5, np.zeros(3))
    for sample in map(drawn.sample, range(40)):
        others = [index for index in training if index != sample.target]
        views = select_views(cameras[sample.target], [cameras[index] for index in others], 4, np.zeros(3), fade=True)
        nearest = [others[index] for index in views.indices]
        assert 0 <= sample.source_weights.min() <= sample.source_weights.max() <= 1
        if sorted(nearest) == sorted(sample.sources):
            expected = dict(zip(nearest, views.weights, strict=True))
            np.testing.assert_allclose(sample.source_weights, [expected[index] for index in sample.sources])


def test_without_fading_all_views_have_equal_weights() -> None:
    """Catches view weights in training for a model that is rendered without view weights."""
    config = TrainConfig(model=ModelConfig(fade_views=False))
    drawn = StepSampler(config, ring(10), [0, 1, 2, 4, 5, 6, 7, 9], 5, np.zeros(3))
    assert drawn.sample(0).source_weights.tolist() == [1, 1, 1, 1]


def test_an_epoch_draws_every_view_of_every_frame_once() -> None:
    drawn = sampler()
    drawn_pairs = {(sample.frame, sample.target) for sample in map(drawn.sample, range(40))}
    assert len(drawn_pairs) == 40


def test_samples_depend_on_seed_and_step_alone() -> None:
    """Catches a sampler that stores state between steps. A resumed run would then draw different samples."""
    whole = [sampler().sample(step) for step in range(10)]
    late = sampler().sample(9)
    assert (late.frame, late.target, late.sources) == (whole[9].frame, whole[9].target, whole[9].sources)
    np.testing.assert_array_equal(late.background_colour, whole[9].background_colour)
    other = [sampler(4).sample(step) for step in range(10)]
    assert [c.target for c in other] != [c.target for c in whole]


@pytest.mark.parametrize(("scene", "least"), [("object", 8), ("full", 12)])
def test_full_scenes_draw_more_layers(scene: Literal["object", "full"], least: int) -> None:
    """Catches too few depth layers for the floor of a full scene. The discs of the floor would grow until the image is
    blurred."""
    drawn = StepSampler(TrainConfig(seed=3, scene=scene), ring(10), [0, 1, 2, 4, 5, 6, 7, 9], 5, np.zeros(3))
    assert {drawn.sample(step).layers for step in range(200)} == set(range(least, 16))


def test_rates_warm_up_and_decay_to_the_final_factor() -> None:
    rates = RateConfig(final=0.1, warm_up=10)
    assert rate_factor(rates, 0, 0.0) == pytest.approx(0.1)
    assert rate_factor(rates, 9, 0.0) == pytest.approx(1.0)
    assert rate_factor(rates, 500, 1.0) == pytest.approx(0.1)


def test_the_first_exhausted_budget_counts() -> None:
    config = TrainConfig(max_steps=100, max_seconds=10.0)
    assert budget_spent(config, 50, 1.0) == 0.5
    assert budget_spent(config, 50, 9.0) == 0.9
    assert budget_spent(config, 500, 9.0) == 1.0


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [("points", 0, "points: expected"), ("layers", 65, "layers: expected"), ("neighbour_pool", 2, "neighbour_pool")],
)
def test_errors_name_values_out_of_range(field: str, value: int, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        TrainConfig(**{field: value})
