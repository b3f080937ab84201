"""Runs that take a second or two: few points, small planes, the ball capture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rich.console import Console

from fourd.model.config import ModelConfig, PlanesConfig
from fourd.training.config import TrainConfig
from fourd.training.loop import Trainer, TrainSummary
from fourd.training.run import Run, create_run

SMALL = TrainConfig(
    model=ModelConfig(planes=PlanesConfig(levels=2, features=4, base_resolution=16), hidden=16),
    points=1500,
    layers=8,
    least_layers=6,
    test_views=("03",),
    max_steps=6,
    checkpoint_steps=3,
    encoder_every=2,
)


def quiet() -> Console:
    """A console that shows nothing."""
    return Console(quiet=True)


def train(run: Run, config: TrainConfig) -> TrainSummary:
    """Train a run to the end of ``config``'s budget."""
    return Trainer(run, None, quiet(), config).train()


def trained_run(capture: Path, folder: Path, config: TrainConfig = SMALL) -> Run:
    """A run made and trained."""
    run = create_run(capture, folder, config)
    train(run, run.config.train)
    return run


def with_steps(config: TrainConfig, steps: int) -> TrainConfig:
    """The same config with another budget."""
    return replace(config, max_steps=steps)
