"""Training on a GPU, and on a fake device that finds tensors on the wrong device on machines without a GPU."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.base.errors import UserError
from fourd.pipeline.make import create_run
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.train import train_run
from fourd.reconstruction.training.config import RefineConfig, TrainConfig
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.occlusion import _maximum_filter
from fourd.reconstruction.training.run import load_run, open_run
from fourd.rendering.ops.gpu import CPU, choose_device, has_gpu
from tests.fake_gpu import FAKE_GPU, fake_gpu
from tests.training.small import SMALL, full_config, quiet, with_steps

CONFIGS = {
    "object": SMALL,
    "refined": replace(SMALL, refine=RefineConfig(poses=True, focal=True, colours=True)),
    "sh": replace(SMALL, model=replace(SMALL.model, appearance="sh", sh="explicit")),
    "residual": replace(SMALL, model=replace(SMALL.model, residual=True)),
}


@pytest.fixture(params=["fake", "cuda"])
def device(request: pytest.FixtureRequest) -> Iterator[torch.device]:
    if request.param == "cuda":
        if not has_gpu():
            pytest.skip("no CUDA device here, or no kernels for it")
        yield torch.device("cuda", 0)
    else:
        with fake_gpu() as device:
            yield device


def config_named(name: str, folder: Path) -> TrainConfig:
    return full_config(folder / "shell.ply", shadow=True) if name == "full" else CONFIGS[name]


def trained(capture: Path, folder: Path, config: TrainConfig, device: torch.device) -> Trainer:
    run = create_run(capture, folder, config)
    trainer = Trainer(run, None, quiet(), run.config.train, device=device)
    trainer.train()
    return trainer


@pytest.mark.parametrize("name", [*CONFIGS, "full"])
def test_a_gpu_trains_the_same_scene(name: str, ball_capture: Path, tmp_path: Path, device: torch.device) -> None:
    """Catches tensors that training creates on the CPU and combines with tensors of a GPU, and steps that differ."""
    config = config_named(name, tmp_path)
    on_cpu = trained(ball_capture, tmp_path / "cpu", config, CPU)
    on_gpu = trained(ball_capture, tmp_path / "gpu", config, device)
    assert on_gpu.frames.get(0).xyz.device == device
    assert abs(on_cpu.psnr - on_gpu.psnr) < (0.001 if device == FAKE_GPU else 0.05)
    for trainer in (on_cpu, on_gpu):
        trainer.frames.close()
    pictures = []
    for folder in ("cpu", "gpu"):
        run = load_run(tmp_path / folder)
        pictures.append(run.render(0, run.run.capture.cameras[0], 8).rgb)
        run.close()
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.01


@pytest.mark.filterwarnings("ignore:for .* copying from a non-meta parameter")  # The fake device copies all the same.
def test_a_run_of_a_gpu_resumes_on_the_cpu_and_back(ball_capture: Path, tmp_path: Path, device: torch.device) -> None:
    """Catches checkpoints that contain tensors of a GPU, or that only the same device can load."""
    trained(ball_capture, tmp_path / "run", SMALL, device).frames.close()
    for steps, where in ((9, CPU), (12, device)):
        with open_run(tmp_path / "run") as run:
            trainer = Trainer(run, None, quiet(), with_steps(run.config.train, steps), device=where)
            assert trainer.done == steps - 3
            assert trainer.train().steps == steps
            trainer.frames.close()


def test_the_maximum_filter_of_a_gpu_equals_that_of_the_cpu(device: torch.device, rng: np.random.Generator) -> None:
    """Catches pixels outside the image that count as a surface."""
    image = torch.from_numpy(rng.random((23, 31), np.float32))
    for reach in (1, 7):
        assert torch.equal(_maximum_filter(image.to(device), reach).cpu(), _maximum_filter(image, reach))


def test_a_gpu_with_too_little_memory_is_one_line(
    ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a traceback if the memory of a GPU does not suffice."""

    def run_out(*arguments: object) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory.\nTried to allocate 20 GiB")

    create_run(ball_capture, tmp_path / "run", SMALL)
    monkeypatch.setattr(Trainer, "train", run_out)
    message = (
        "--device: expected a GPU with enough free memory, got 'CUDA out of memory. Tried to allocate 20 GiB'; use "
    )
    with pytest.raises(UserError, match=message):
        train_run(tmp_path / "run", None, SMALL, Context())


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
def test_a_missing_gpu_is_reported_and_auto_uses_the_cpu() -> None:
    """Catches training that silently uses the CPU although the user asked for a GPU."""
    assert choose_device("auto") == CPU
    with pytest.raises(UserError, match=r"--device: expected an NVIDIA GPU .* got no GPU .*; use --device cpu"):
        choose_device("cuda")
