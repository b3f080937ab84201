"""Stages of a run with segments (ranges of frames with separate models). The stages before training work on all frames.
Then each segment is trained by its own stage, as a separate run in ``RUN/segments/``.

The run of a segment has its own links to the initial points of its frames, so it can be trained, resumed, evaluated and
played like any run, on any machine that has the capture.
"""

from __future__ import annotations

import gc
import os
import shutil
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from fourd.base.configs import save_config
from fourd.base.files import atomic_path
from fourd.base.processes import locked_folder
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.stage import Context, Leftovers, Stage
from fourd.pipeline.stages.train import PREPARED_BY, TrainFiles, expected_training_s, start_run, train_run
from fourd.reconstruction.carving.sequence import BOUNDS_NAME
from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views
from fourd.reconstruction.training.checkpoints import latest_checkpoint
from fourd.reconstruction.training.config import SegmentConfig, TrainConfig
from fourd.reconstruction.training.distributed.process_group import ALONE
from fourd.reconstruction.training.run import Run, RunConfig, open_run, remove_leftovers
from fourd.reconstruction.training.run_layout import (
    CHECKPOINTS,
    CONFIG_NAME,
    HULL,
    PREPARATION,
    SEGMENTS,
    segment_folder,
    segment_folders,
)
from fourd.reconstruction.training.segments.plan import SegmentPlan, frame_range
from fourd.reconstruction.training.segments.warm_start import write_warm_start

DIVIDE = "segments"
"""Name of the stage that divides a run into segments."""


@dataclass(frozen=True)
class DivideFiles:
    """The folders of the capture and of the run. The config is written to the run folder."""

    capture: Path
    run: Path


@dataclass(frozen=True)
class SegmentFiles:
    """The files that the training of a segment reads and writes.

    Attributes:
        run: the folder of the whole run.
        segment: the folder of the segment's run.
        previous: the folder of the previous segment, whose networks initialise the training. If None, the networks
            start untrained.
        lpips_weights: file or folder with the weights of LPIPS. If None, the default locations are searched.
    """

    run: Path
    segment: Path
    previous: Path | None
    lpips_weights: Path | None


def divide_stage(files: TrainFiles, config: TrainConfig) -> Stage[DivideFiles, TrainConfig]:
    """Create the stage that writes the config of a run with segments."""
    return Stage(
        DIVIDE,
        run_divide,
        DivideFiles(files.capture, files.run),
        config,
        outputs=(files.run / CONFIG_NAME,),
        leftovers=(Leftovers(files.run, keep=(*PREPARATION, SEGMENTS)),),
        after=PREPARED_BY,
        starts_run=True,
    )


def selected_frames(capture: Path, config: TrainConfig) -> tuple[int, ...]:
    """Return the numbers of the frames of a capture that the config selects."""
    with open_run_views(capture, DataSelection.of(config)) as views:
        return tuple(views.capture.frame_numbers)


def segment_stages(files: TrainFiles, config: TrainConfig, numbers: Sequence[int]) -> tuple[AnyStage, ...]:
    """Create the stages that train the segments of a run with the frames ``numbers``."""
    plan = SegmentPlan.divide(len(numbers), config.segments)
    return tuple(_train_stage(files, config, plan, numbers, index) for index in range(len(plan.ranges)))


def _train_stage(
    files: TrainFiles, config: TrainConfig, plan: SegmentPlan, numbers: Sequence[int], index: int
) -> Stage[SegmentFiles, TrainConfig]:
    folder = segment_folder(files.run, index)
    previous = segment_folder(files.run, index - 1) if config.segments.warm_start and index > 0 else None
    return Stage(
        f"train {folder.name}",
        run_segment,
        SegmentFiles(files.run, folder, previous, files.lpips_weights),
        replace(config, frames=frame_range(numbers, plan.ranges[index]), segments=SegmentConfig()),
        outputs=(folder / CHECKPOINTS,),
        leftovers=(Leftovers(folder),),
        after=(DIVIDE, *(() if previous is None else (f"train {previous.name}",))),
        is_parallel=True,
        has_checkpoints=True,
        expected_s=expected_training_s,
    )


def run_divide(files: DivideFiles, config: TrainConfig, context: Context) -> None:
    """Write the config of the whole run. If an earlier division had more segments, remove the surplus segments."""
    with start_run(files.capture, files.run, config) as run:
        plan = SegmentPlan.divide(run.capture.frame_count, config.segments)
    for folder in segment_folders(files.run):
        if int(folder.name) >= len(plan.ranges):
            shutil.rmtree(folder)
    lengths = sorted({len(frames) for frames in plan.ranges})
    context.log(
        f"{files.run}: {len(plan.ranges)} segments of {' or '.join(str(length) for length in lengths)} frames, "
        f"which share {plan.overlap} frames with the next segment"
    )


def run_segment(files: SegmentFiles, config: TrainConfig, context: Context) -> None:
    """Start the run of a segment, or resume it from its newest checkpoint. A segment that has already
    spent the step or time budget in ``config`` is not trained again."""
    group = context.group or ALONE
    # The folder is locked, because the same task may run twice: if the cluster loses the connection to a node, it
    # restarts the node's task on another node.
    with locked_folder(files.segment) if group.is_first else nullcontext():
        if group.is_first:
            _prepare_segment(files, config)
        group.barrier()
        train_run(files.segment, files.lpips_weights, config, context)
    # The trainer contains reference cycles, so its memory would otherwise stay allocated while the next segments are
    # trained.
    gc.collect()


def _prepare_segment(files: SegmentFiles, config: TrainConfig) -> None:
    """Prepare the folder of a segment's run for training. Write the run's initial points and config unless they exist.
    If there is a previous segment and the run has no checkpoint yet, write one with the previous segment's networks."""
    remove_leftovers(files.segment)
    if not (files.segment / CONFIG_NAME).exists():
        with open_run(files.run) as whole:
            _start_segment(whole, files.segment, config)
    if files.previous is not None and latest_checkpoint(files.segment / CHECKPOINTS)[0] is None:
        with open_run(files.segment) as run:
            write_warm_start(run, files.previous)


def _start_segment(whole: Run, folder: Path, config: TrainConfig) -> None:
    """Link the initial points of the segment's frames into its folder, and write its config.yaml."""
    with open_run_views(whole.config.capture, DataSelection.of(config)) as views:
        numbers = views.capture.frame_numbers
    for name in (BOUNDS_NAME, *(f"{number:06d}.ply" for number in numbers)):
        _link(whole.folder / HULL / name, folder / HULL / name)
    scene = replace(whole.config.scene, first_frame=numbers[0], frame_count=numbers[-1] - numbers[0] + 1)
    save_config(RunConfig(whole.config.capture, scene, config), folder / CONFIG_NAME)


def _link(source: Path, target: Path) -> None:
    """Create a hard link to a file, or copy it if the file system has no hard links. A hard link is safe, because no
    stage changes the file in place."""
    with atomic_path(target) as temporary:
        temporary.unlink()
        try:
            os.link(source, temporary)
        except OSError:
            shutil.copyfile(source, temporary)
