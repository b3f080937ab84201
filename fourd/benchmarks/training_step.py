"""Whole training steps on a synthetic capture. They do the same work as the steps of `fourd train`, but read no
images."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from fourd.base.progress import Terminal
from fourd.benchmarks.timing import Work
from fourd.pipeline.make import create_run
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.memory import retain_freed_memory
from fourd.reconstruction.training.run import Run
from fourd.recording.synth import make_synthetic

POINTS = 65_536
SIZE = 512
CAMERAS = 6
DEFAULT = TrainConfig(points=POINTS, max_steps=10_000)


def training_steps(resources: ExitStack) -> Iterator[tuple[str, Work]]:
    """Yield four training steps with their names.

    Two use the default config, and two use whole images and every point. For each config, one step trains the image
    CNN, and the other keeps it frozen.

    The capture is in a temporary folder, which is removed when ``resources`` is closed.
    """
    retain_freed_memory()
    folder = _make_capture(resources)
    default = DEFAULT
    whole = replace(default, crop="full", hidden_weight=0.0, least_layers=default.layers)
    size = f"{POINTS:,} points, {SIZE} x {SIZE}, {default.model.neighbours} source views"
    for name, config in (("the foreground's box, visible points", default), ("whole pictures, all points", whole)):
        run = create_run(folder / "capture", folder / name.split(",")[0], config)
        for learning in (False, True):
            encoder = "image CNN learning" if learning else "image CNN frozen"
            yield f"training step, {size}: {name}, {encoder}", _step(run, config, learning)


def synthetic_run(resources: ExitStack) -> Run:
    """Create a run with the default config, in a temporary folder that is removed when ``resources`` is closed."""
    folder = _make_capture(resources)
    return create_run(folder / "capture", folder / "run", DEFAULT)


def _make_capture(resources: ExitStack) -> Path:
    """Return a temporary folder in which ``capture`` is a synthetic capture."""
    folder = Path(resources.enter_context(TemporaryDirectory(prefix="fourd-bench-")))
    make_synthetic(folder / "capture", frames=1, cameras=CAMERAS, size=SIZE, seed=0, gloss=0.3)
    return folder


def _step(run: Run, config: TrainConfig, learning: bool) -> Work:
    """Return a function that runs one training step. If ``learning`` is true, the step also trains the image CNN;
    otherwise, the CNN is frozen. The function can be called repeatedly, because the learning rates are so small that
    its steps do not change the scene."""
    trainer = Trainer(run, None, Terminal(quiet=True), config)
    sample = trainer.sampler.sample(1)
    points = trainer.frames.get(sample.frame)
    number = 0 if learning else 1
    scene = trainer.scene
    return lambda: trainer.stepper.step(points, 0.0, sample, 1e-6, scene.prepare(points, sample), number)
