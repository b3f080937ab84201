"""Still scenes: scenes that consist only of a background, made from one frame or from a recording in which nothing
moves.

The given capture is not changed. A new folder gets links to this capture's files, and empty mattes, so that each
image is the clean plate of its camera. The frames of the run have no foreground points.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fourd.base.files import resolved, write_text_atomically
from fourd.base.formats.picture import write_picture
from fourd.base.formats.ply import write_ply
from fourd.pipeline.stage import Artefact, Context, Leftovers, NoSettings, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.reconstruction.carving import Bounds
from fourd.reconstruction.carving.sequence import BOUNDS_NAME
from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views
from fourd.reconstruction.training.run_layout import BACKGROUND, CALIBRATION, COLOURS, HULL
from fourd.recording.capture import open_capture
from fourd.recording.capture.focus import viewing_centre
from fourd.recording.capture.layout import DERIVED, link_entries

DONE = "still.json"
BOUNDS_SHARE = 0.25
"""Half the side length of the scene's bounds, as a fraction of the cameras' mean distance to the point that they
face."""


@dataclass(frozen=True)
class StillFiles:
    """The folder of the given capture, and the new folder for the capture with empty mattes."""

    capture: Path
    still: Path


@dataclass(frozen=True)
class NoPointFiles:
    """The folders of the capture with empty mattes and of the run. Empty point files are written to ``hull/`` in the
    run folder."""

    capture: Path
    run: Path


def still_stage(capture: Path, still: Path) -> Stage[StillFiles, NoSettings]:
    """Create the stage that writes ``capture`` with empty mattes to the new folder ``still``."""
    return Stage(
        "still",
        run_still,
        StillFiles(capture, still),
        NoSettings(),
        inputs=(Artefact(capture, INPUT_PATTERNS),),
        outputs=(still / DONE,),
        leftovers=(Leftovers(still),),
    )


def run_still(files: StillFiles, settings: NoSettings, context: Context) -> None:
    """Link the files of the capture, and write an empty matte for each image."""
    files.still.mkdir(parents=True, exist_ok=True)
    link_entries(files.capture, files.still, left_out={DERIVED.name, "masks"})
    with open_capture(files.capture, mattes=False) as capture:
        for name, lens in zip(capture.names, capture.distorted_cameras, strict=True):
            folder = files.still / "masks" / name
            folder.mkdir(parents=True, exist_ok=True)
            for frame in capture.frame_names:
                write_picture(folder / f"{frame}.png", np.zeros((lens.height, lens.width), np.uint8))
    write_text_atomically(files.still / DONE, json.dumps({"capture": str(resolved(files.capture))}) + "\n")


def no_points_stage(capture: Path, run: Path, selection: DataSelection) -> Stage[NoPointFiles, DataSelection]:
    """Create the stage that writes an empty file of foreground points for each frame of a run."""
    return Stage(
        "points",
        run_no_points,
        NoPointFiles(capture, run),
        selection,
        outputs=(run / HULL / BOUNDS_NAME,),
        leftovers=(Leftovers(run, keep=(BACKGROUND, CALIBRATION, COLOURS)),),
        after=("adjust",),
    )


def run_no_points(files: NoPointFiles, selection: DataSelection, context: Context) -> None:
    """Write an empty PLY file for each frame, and bounds around the point that the cameras face."""
    views = open_run_views(files.capture, selection)
    cameras = [views.capture.cameras[index] for index in views.training]
    centre = viewing_centre(cameras)
    half = BOUNDS_SHARE * float(np.mean([np.linalg.norm(camera.centre - centre) for camera in cameras]))
    hull = files.run / HULL
    for number in views.capture.frame_numbers:
        write_ply(hull / f"{number:06d}.ply", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    bounds = Bounds(centre - half, centre + half)
    corners = {"lower": bounds.lower.tolist(), "upper": bounds.upper.tolist()}
    write_text_atomically(hull / BOUNDS_NAME, json.dumps(corners, indent=1) + "\n")
