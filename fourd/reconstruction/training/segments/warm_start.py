"""Start a segment from the trained networks of the previous segment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from fourd.base.errors import UserError
from fourd.reconstruction.model.kplanes import KPlanes
from fourd.reconstruction.model.point_model import PointModel
from fourd.reconstruction.training.checkpoints import (
    SavedProgress,
    checkpoint_path,
    latest_checkpoint,
    load_checkpoint,
    save_checkpoint,
)
from fourd.reconstruction.training.run import Run, open_run
from fourd.reconstruction.training.run_layout import CHECKPOINTS, points_folder

PREFIX = "model."
"""Prefix of the names of the model's tensors in checkpoints."""


def write_warm_start(run: Run, previous: Path) -> None:
    """Write a checkpoint at step 0 with the networks of the previous segment. The points and the optimizer state are
    those of an untrained segment.

    Each row of a time plane belongs to one frame. Rows of frames that belong to both segments are copied. Rows of later
    frames are copies of the previous segment's last row.

    Args:
        run: the new segment, which has no checkpoint yet.
        previous: folder of the trained previous segment.

    Raises:
        UserError: if the previous segment has no checkpoint.
    """
    found, _ = latest_checkpoint(previous / CHECKPOINTS)
    if found is None:
        raise UserError(f"{previous}: expected a trained segment to start from, got no checkpoint; train it first")
    _, tensors, _ = load_checkpoint(found)
    with open_run(previous) as opened:
        shift = run.config.scene.first_frame - opened.config.scene.first_frame
    model = run.new_model()
    started = {f"{PREFIX}{name}": value for name, value in _shifted(model, tensors, shift).items()}
    target = checkpoint_path(run.checkpoints, 0)
    points = run.frame_store(None)
    try:
        points.save(points_folder(target))
    finally:
        points.close()
    save_checkpoint(run.checkpoints, 0, started, SavedProgress(seconds=0.0, psnr=0.0).to_json())


def _shifted(model: PointModel, tensors: Mapping[str, Tensor], shift: int) -> dict[str, Tensor]:
    """Return the state dict of ``model``, filled with the tensors of the previous segment's checkpoint. The first frame
    of ``model`` is the frame with the index ``shift`` in the previous segment."""
    state = model.state_dict()
    for name, value in state.items():
        given = tensors[f"{PREFIX}{name}"]
        if name in time_plane_names(model):
            rows = (torch.arange(value.shape[0]) + shift).clamp(max=given.shape[0] - 1)
            given = given[rows]
        state[name] = given
    return state


def time_plane_names(model: PointModel) -> set[str]:
    """Return the names of the time planes in ``model.state_dict()``. Time planes have one row per frame."""
    return {
        f"{name}.planes.{index}"
        for name, module in model.named_modules()
        if isinstance(module, KPlanes)
        for index in module.time_plane_indices
    }
