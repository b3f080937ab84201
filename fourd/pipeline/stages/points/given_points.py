"""Given points: takes the initial points from the user's FRAME.ply files instead of carving them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.formats.ply import read_ply, write_ply
from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage
from fourd.reconstruction.carving import Bounds
from fourd.reconstruction.carving.sequence import BOUNDS_NAME
from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views
from fourd.reconstruction.training.run_layout import BACKGROUND, CALIBRATION, COLOURS, HULL


@dataclass(frozen=True)
class GivenPointFiles:
    """The folders of the capture, of the user's points and of the run. The points are written to ``hull/`` in the run
    folder."""

    capture: Path
    source: Path
    run: Path


@dataclass(frozen=True)
class GivenPointSettings:
    """Selected frames, maximum number of points per frame, and the seed of the random sample."""

    selection: DataSelection
    points: int
    seed: int


def given_points_stage(
    capture: Path, source: Path, run: Path, settings: GivenPointSettings
) -> Stage[GivenPointFiles, GivenPointSettings]:
    """Create the stage that copies the points in the folder ``source`` to a run, as its initial points."""
    return Stage(
        "points",
        run_given_points,
        GivenPointFiles(capture, source, run),
        settings,
        inputs=(Artefact(source, ("*.ply",)),),
        outputs=(run / HULL / BOUNDS_NAME,),
        leftovers=(Leftovers(run, keep=(BACKGROUND, CALIBRATION, COLOURS)),),
        after=("adjust",),
    )


def run_given_points(files: GivenPointFiles, settings: GivenPointSettings, context: Context) -> None:
    """Copy a uniform random sample of each frame's points, and write the bounds of all frames' points, extended by
    5%."""
    with open_run_views(files.capture, settings.selection) as views:
        capture = views.capture
    rng = np.random.default_rng(settings.seed)
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    hull = files.run / HULL
    for number in capture.frame_numbers:
        name = f"{number:06d}.ply"
        xyz, rgb = read_ply(files.source / name)
        if len(xyz) == 0:
            raise UserError(f"{files.source / name}: expected points, got none; leave the frame out")
        kept = rng.permutation(len(xyz))[: settings.points]
        write_ply(hull / name, xyz[kept], rgb[kept])
        lower, upper = np.minimum(lower, xyz.min(axis=0)), np.maximum(upper, xyz.max(axis=0))
    bounds = Bounds(lower, upper).padded(0.05)
    corners = {"lower": bounds.lower.tolist(), "upper": bounds.upper.tolist()}
    write_text_atomically(hull / BOUNDS_NAME, json.dumps(corners, indent=1) + "\n")
