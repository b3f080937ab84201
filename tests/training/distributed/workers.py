"""Work of one rank. Tests run this module in a process: ``python -m tests.training.distributed.workers FOLDER``."""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from safetensors.torch import save_file

from fourd.reconstruction.model.config import ModelConfig, PlanesConfig
from fourd.reconstruction.model.point_model import PointModel
from fourd.reconstruction.training.distributed.process_group import ProcessGroup, join_process_group
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.metrics_log import NoLog
from fourd.reconstruction.training.run import open_run
from tests.training.small import quiet


def small_model() -> PointModel:
    """A model in float64 whose colours are spherical harmonics."""
    torch.manual_seed(0)
    planes = PlanesConfig(levels=2, features=4, base_resolution=16)
    config = ModelConfig(planes=planes, hidden=16, appearance="sh")
    return PointModel(config, torch.zeros(3).numpy(), torch.ones(3).numpy(), 0.05, 4).double()


def frame_gradients(model: PointModel, frame: int) -> None:
    """Compute the gradients of a loss for the points of one frame. The points and the loss depend on the frame."""
    points = torch.Generator().manual_seed(frame)
    xyz = torch.rand(200, 3, generator=points, dtype=torch.float64)
    evaluated = model.evaluate(xyz, torch.full((200,), 0.05, dtype=torch.float64), frame / 3)
    harmonics = model.harmonics(evaluated, is_training=True)
    assert harmonics is not None
    loss = (evaluated.radius * xyz[:, 0]).sum() + (evaluated.density * xyz[:, 1]).sum()
    if frame == 0:
        loss = loss + harmonics.square().sum() + harmonics[:, 0, 0].sum()
    model.zero_grad(set_to_none=True)
    loss.backward()


def average(group: ProcessGroup, out: Path) -> None:
    """Average the gradients of a small float64 model over the ranks. Only rank 0 has gradients of the parameters that
    produce spherical harmonics."""
    model = small_model()
    frame_gradients(model, group.rank)
    group.average_gradients(model.parameters())
    _save(model.named_parameters(), out / f"average-{group.rank}.safetensors")


def train_step(group: ProcessGroup, out: Path) -> None:
    """Run the first training step of the run in the folder ``out``, and save its gradients."""
    trainer = Trainer(open_run(out / "run"), None, quiet(), open_run(out / "run").config.train, group)
    record_gradients(trainer, out / f"step-{group.rank}.safetensors")
    trainer._step(NoLog())


def record_gradients(trainer: Trainer, file: Path) -> None:
    """Save the gradients of the dense parameters at the moment when the optimizer uses them."""
    update = trainer.stepper.optimizer.step

    def record() -> None:
        _save(((str(i), each) for i, each in enumerate(trainer.stepper.dense_parameters)), file)
        update()

    trainer.stepper.optimizer.step = record  # type: ignore[method-assign, assignment]


def _save(named, file: Path) -> None:  # type: ignore[no-untyped-def]
    save_file(
        {
            name: value.grad.clone(memory_format=torch.contiguous_format)
            for name, value in named
            if value.grad is not None
        },
        file,
    )


if __name__ == "__main__":
    with join_process_group() as ranks:
        average(ranks, Path(sys.argv[1]))
        train_step(ranks, Path(sys.argv[1]))
