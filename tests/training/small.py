"""Small training runs on the ball capture. Each run takes one or two seconds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from fourd.base.formats.ply import write_ply
from fourd.pipeline.make import create_run
from fourd.reconstruction.model.config import ModelConfig, PlanesConfig
from fourd.reconstruction.training.config import BackgroundConfig, DensifyConfig, RefineConfig, TrainConfig
from fourd.reconstruction.training.loop import Trainer, TrainSummary
from fourd.reconstruction.training.run import Run
from tests.captures import sphere

SMALL = TrainConfig(
    model=ModelConfig(planes=PlanesConfig(levels=2, features=4, base_resolution=16), hidden=16),
    points=1500,
    layers=8,
    least_layers=6,
    test_views=("03",),
    max_steps=6,
    checkpoint_steps=3,
    encoder_every=2,
    refine=RefineConfig(colours=False),
)


def full_config(seeds: Path, points: int = 1200, *, shadow: bool = False) -> TrainConfig:
    """A small config for a full scene. This function writes a grey shell of background points to the file ``seeds``."""
    xyz = 5 * sphere(points)
    write_ply(seeds, xyz, np.full((points, 3), 89, np.uint8))
    planes = PlanesConfig(levels=2, features=4, base_resolution=16, time=False)
    background = BackgroundConfig(
        points=points, seeds=seeds, planes=planes, window_px=32, margin_px=8, encoder_every=2, shadow=shadow
    )
    densify = DensifyConfig(frame_every=2, background_every=4)
    return replace(SMALL, scene="full", background=background, densify=densify)


def quiet() -> Console:
    """A console without output."""
    return Console(quiet=True)


def train(run: Run, config: TrainConfig) -> TrainSummary:
    """Train a run until the budget of ``config`` is used up."""
    return Trainer(run, None, quiet(), config).train()


def trained_run(capture: Path, folder: Path, config: TrainConfig = SMALL) -> Run:
    """Create a run and train it."""
    run = create_run(capture, folder, config)
    train(run, run.config.train)
    return run


def with_steps(config: TrainConfig, steps: int) -> TrainConfig:
    """Return ``config`` with a budget of ``steps`` training steps."""
    return replace(config, max_steps=steps)
