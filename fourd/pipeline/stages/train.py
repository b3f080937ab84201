"""Training: writes the run's config.yaml, and then trains until the budget is spent."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from fourd.base.configs import save_config
from fourd.base.errors import MAX_REASON, UserError, one_line
from fourd.base.files import resolved
from fourd.base.formats.ply import read_ply
from fourd.pipeline.stage import Context, Leftovers, Stage
from fourd.pipeline.unused_gpu import tell_once
from fourd.pipeline.workload import Workload
from fourd.reconstruction.background.contraction import contraction_around
from fourd.reconstruction.carving import read_bounds
from fourd.reconstruction.training.cameras.measured_colours import corrects_colours, read_measured_colours
from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.distributed.process_group import ALONE, ProcessGroup
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.losses.lpips import load_lpips
from fourd.reconstruction.training.points.near_plane import choose_near, read_static_near, sample_hull
from fourd.reconstruction.training.points.spacing import mean_spacing
from fourd.reconstruction.training.run import Run, RunConfig, SceneConfig, open_run
from fourd.reconstruction.training.run_layout import CHECKPOINTS, CONFIG_NAME, HULL, PREPARATION
from fourd.rendering.ops.gpu import choose_device, cuda_unavailable_reason

TRAIN_S_PER_STEP = 0.3
"""Seconds per training step. Measured: 821 steps in 246 s with 20,000 points on 2 cores."""
PREPARED_BY = ("adjust", "colours", "carve", "points", "background")
"""Names of the stages whose results training reads."""


@dataclass(frozen=True)
class TrainFiles:
    """The folders of the capture and of the run, and the path of the LPIPS weights. If this path is None, the default
    locations are searched; see :func:`load_lpips`."""

    capture: Path
    run: Path
    lpips_weights: Path | None = None


def train_stage(files: TrainFiles, config: TrainConfig) -> Stage[TrainFiles, TrainConfig]:
    """Create the stage that trains a run until the budget in the config is spent."""
    return Stage(
        "train",
        run_train,
        files,
        config,
        outputs=(files.run / CHECKPOINTS,),
        leftovers=(Leftovers(files.run, keep=PREPARATION),),
        after=PREPARED_BY,
        has_checkpoints=True,
        starts_run=True,
        expected_s=expected_training_s,
    )


def expected_training_s(config: TrainConfig, workload: Workload) -> float:
    """Return the expected duration of training in seconds: that of the step or time budget, or infinity without one."""
    steps_s = math.inf if config.max_steps is None else TRAIN_S_PER_STEP * config.max_steps
    return min(steps_s, math.inf if config.max_seconds is None else config.max_seconds)


def run_train(files: TrainFiles, config: TrainConfig, context: Context) -> None:
    """Start the run, or resume it from its newest checkpoint. Only the budget of a resumed run may change."""
    group = context.group or ALONE
    if group.is_first and not (files.run / CONFIG_NAME).exists():
        with start_run(files.capture, files.run, config) as run:
            context.log(f"near plane: {run.config.scene.near:.3g} world units")
    group.barrier()
    train_run(files.run, files.lpips_weights, config, context)


def train_run(folder: Path, lpips_weights: Path | None, config: TrainConfig, context: Context) -> None:
    """Train an existing run until the budget of ``config`` is spent, starting from its newest checkpoint if it has one.
    All ranks call this function."""
    lpips, group = load_lpips(lpips_weights), context.group or ALONE
    if lpips is None:
        context.log("LPIPS: no weights found; the loss uses 1 - SSIM instead (name the weights with --lpips-weights)")
    device = _training_device(context)
    with open_run(folder) as run:
        require_frames(run.capture.frame_count, group)
        budget = replace(run.config.train, max_steps=config.max_steps, max_seconds=config.max_seconds)
        try:
            trainer = Trainer(run, lpips, context.console, budget, group, device)
            with closing(trainer.frames):
                summary = trainer.train(context.on_step)
        except torch.OutOfMemoryError as error:
            reason = one_line(error, MAX_REASON)
            raise UserError(
                f"--device: expected a GPU with enough free memory, got '{reason}'; use fewer --points, a smaller "
                "--scale or --device cpu, and add --resume if the run has a checkpoint"
            ) from error
    context.log(f"{folder}: {summary.steps} steps, {summary.seconds:.0f} s, {summary.psnr:.2f} dB on training views")


def _training_device(context: Context) -> torch.device:
    """Choose the device that trains. If it is a GPU, log its name. If "auto" selects the CPU although
    there is a GPU, log the reason, and once how to use the GPU."""
    device = choose_device(context.device)
    if device.type == "cuda":
        context.log(f"device: training on {torch.cuda.get_device_name(device)}")
    elif context.device == "auto" and torch.cuda.is_available():
        context.log(f"device: training on the CPU, because the GPU cannot be used ({cuda_unavailable_reason()})")
    if device.type == "cpu" and context.device == "auto":
        tell_once(context.log)
    return device


def require_divisible(config: TrainConfig, group: ProcessGroup) -> None:
    """End all ranks with an error if the scene cannot be trained by several ranks. All ranks call this function."""
    if group.size > 1 and config.scene == "full":
        group.refuse(
            f"torchrun: expected --scene object with several ranks, got --scene full and {group.size} ranks; start "
            "fourd train without torchrun"
        )


def require_frames(frames: int, group: ProcessGroup) -> None:
    """End all ranks with an error if there are more ranks than frames. All ranks call this function."""
    if group.size > frames:
        group.refuse(
            f"torchrun: expected at most one rank per frame, got {group.size} ranks and {frames} frames; set "
            f"--nproc-per-node to {frames} or less"
        )


def start_run(capture_path: Path, folder: Path, train: TrainConfig) -> Run:
    """Write config.yaml into a run folder that contains the results of the stages before training."""
    selection = DataSelection.of(train)
    with open_run_views(capture_path, selection, folder if train.refine.cameras else None) as views:
        capture = views.capture
    colours = corrects_colours(train.refine.colours, read_measured_colours(folder))
    train = replace(train, refine=replace(train.refine, colours=colours))
    hulls = sample_hull(folder / HULL, capture.frame_numbers)
    static_near = train.near or read_static_near(folder)
    near = train.near or choose_near(capture.cameras, hulls, static_near)
    bounds = read_bounds(folder / HULL)
    first = read_ply(folder / HULL / f"{capture.frame_numbers[0]:06d}.ply").xyz
    lower, upper = ((float(x), float(y), float(z)) for x, y, z in (bounds.lower, bounds.upper))
    scene = SceneConfig(
        lower=lower,
        upper=upper,
        spacing=mean_spacing(first[: train.points]),
        frame_count=max(capture.total_frames, 1),
        reach=contraction_around(capture.cameras, bounds.centre).radius,
        near=near,
        static_near=static_near,
    )
    save_config(RunConfig(resolved(capture_path), scene, train), folder / CONFIG_NAME)
    return open_run(folder)
