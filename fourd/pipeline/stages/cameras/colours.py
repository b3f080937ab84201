"""Colours: measures how much the colours of matching points differ between the cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fourd.pipeline.stage import Artefact, Context, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.workload import Workload
from fourd.reconstruction.training.cameras.measured_colours import MeasuredColours, write_measured_colours
from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.run_layout import COLOURS, MEASURED
from fourd.recording.calibration.camera_matching import match_cameras
from fourd.recording.calibration.checks.agreement import MAX_FRAME_PIXELS, MAX_PICTURE_PIXELS
from fourd.recording.calibration.colours import ColourDifferences, concatenate, measure_colours, sample_colours
from fourd.recording.capture import Capture
from fourd.recording.capture.layout import sample_indices

FRAMES = 2
FEW_CAMERAS = 5
FEW_CAMERAS_FRAMES = 4
"""Number of frames whose images are matched. Up to FEW_CAMERAS cameras have few pairs, so more of their frames are
matched."""


@dataclass(frozen=True)
class ColourFiles:
    """The folders of the capture and of the run. The result is written to ``colours/measured.json`` in the run."""

    capture: Path
    run: Path


def measures_colours(train: TrainConfig) -> bool:
    """Return whether a run measures the colour differences of its cameras. Runs with segments do not correct them."""
    return train.refine.colours is not False and train.segments.frames is None


def colours_stage(capture: Path, run: Path, selection: DataSelection) -> Stage[ColourFiles, DataSelection]:
    """Create the stage that measures the colour differences between the cameras of a run."""
    return Stage(
        "colours",
        run_colours,
        ColourFiles(capture, run),
        selection,
        inputs=(Artefact(capture, INPUT_PATTERNS),),
        outputs=(run / COLOURS,),
        expected_s=_expected_s,
    )


def _expected_s(selection: DataSelection, workload: Workload) -> float:
    return workload.matching_s(FRAMES)


def run_colours(files: ColourFiles, selection: DataSelection, context: Context) -> None:
    """Match the images of all cameras, held-out cameras included, and write the colour map of each camera. Held-out
    cameras change no other camera's map: it is estimated from the training cameras alone."""
    if (files.run / COLOURS / MEASURED).exists():
        return
    with open_run_views(files.capture, selection) as views:
        cameras = views.capture.cameras
    largest = max(camera.width * camera.height for camera in cameras)
    max_pixels = min(MAX_PICTURE_PIXELS, MAX_FRAME_PIXELS / len(cameras))
    scale = selection.image_scale * min(1.0, float(np.sqrt(max_pixels / largest)))
    with open_run_views(files.capture, replace(selection, image_scale=scale)) as views:
        found = measure_capture(views.capture, views.training, context)
        names = views.capture.names
    measured = MeasuredColours(dict(zip(names, found.maps, strict=True)), found.differ)
    write_measured_colours(files.run, measured)
    if found.differ:
        context.log(f"colours: the cameras differ by {found}; the scene has their mean colours")


def measure_capture(capture: Capture, training: list[int], context: Context) -> ColourDifferences:
    """Measure the colour differences of the cameras of ``capture``. The mean map of the cameras with the indices
    ``training`` is the identity."""
    count = len(capture.cameras)
    parts = []
    for frame in sample_indices(capture.frame_count, FRAMES if count > FEW_CAMERAS else FEW_CAMERAS_FRAMES):
        pictures = [capture.image(camera, frame) for camera in range(count)]
        parts.append(sample_colours(pictures, match_cameras([pictures], capture.cameras, context.track)))
    return measure_colours(concatenate(parts), training)
