"""Camera adjustment: bundle adjustment of the training cameras before carving."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fourd.base.errors import UserError
from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.stages.plates import MATTE_PATTERNS
from fourd.reconstruction.training.cameras.calibration import write_corrected
from fourd.reconstruction.training.cameras.rig import Rig
from fourd.reconstruction.training.cameras.selection import DataSelection, RunViews, open_run_views
from fourd.reconstruction.training.config import RefineConfig
from fourd.reconstruction.training.run_layout import CALIBRATION, COLOURS, START
from fourd.recording.calibration.adjustment.adjust import adjust_cameras
from fourd.recording.calibration.adjustment.solver import Prior
from fourd.recording.capture import Capture
from fourd.recording.capture.focus import viewing_centre
from fourd.recording.capture.layout import INTRINSICS_NAME

TILT = 12
"""Index of the first sensor-tilt coefficient among OpenCV's 14 distortion coefficients."""


@dataclass(frozen=True)
class AdjustFiles:
    """The folders of the capture and of the run. The adjusted cameras are written to ``calibration/start/`` in the run
    folder."""

    capture: Path
    run: Path


@dataclass(frozen=True)
class AdjustSettings:
    """Selected views and frames, and the fields of :class:`RefineConfig` that affect the adjustment."""

    selection: DataSelection
    poses: bool
    focal: bool
    rotation_deg: float
    position: float
    focal_spread: float
    band: float

    @classmethod
    def of(cls, selection: DataSelection, refine: RefineConfig) -> AdjustSettings:
        """Take the settings from the selection and from the section ``refine`` of a training config."""
        return cls(
            selection,
            refine.poses,
            refine.focal,
            refine.rotation_deg,
            refine.position,
            refine.focal_spread,
            refine.band,
        )


def adjust_stage(capture: Path, run: Path, settings: AdjustSettings) -> Stage[AdjustFiles, AdjustSettings]:
    """Create the stage that adjusts the initial cameras of the run in the folder ``run``."""
    return Stage(
        "adjust",
        run_adjust,
        AdjustFiles(capture, run),
        settings,
        inputs=(Artefact(capture, INPUT_PATTERNS + MATTE_PATTERNS),),
        outputs=(run / CALIBRATION / START,),
        leftovers=(Leftovers(run, keep=(COLOURS,)),),
    )


def run_adjust(files: AdjustFiles, settings: AdjustSettings, context: Context) -> None:
    """Bundle-adjust the training cameras from matched features, and write them. If adjusted cameras already exist, they
    are kept.

    Held-out cameras are neither used nor changed.
    """
    if (files.run / CALIBRATION / START / INTRINSICS_NAME).exists():
        return
    with open_run_views(files.capture, settings.selection) as views:
        _adjust(files, settings, views, context)


def _adjust(files: AdjustFiles, settings: AdjustSettings, views: RunViews, context: Context) -> None:
    capture, log = views.capture, context.log
    if settings.focal:
        _require_no_tilt(capture)
    found = adjust_cameras(capture, views.training, _prior(views.capture, views.training, settings), settings.band,
                           context.track)  # fmt: skip
    names = views.training_names
    unmatched = [name for name, features in zip(names, found.features, strict=True) if not features]
    if len(unmatched) < len(names):
        log(
            f"cameras: median reprojection error of {int(found.features.sum())} features "
            f"{found.before_px:.2f} px before adjustment, {found.after_px:.2f} px after"
        )
    if unmatched:
        which = "all cameras" if len(unmatched) == len(names) else f"cameras {', '.join(unmatched)}"
        log(f"cameras: too few features match between views; {which} keep the given calibration")
    cameras = list(capture.cameras)
    for index, camera in zip(views.training, found.cameras, strict=True):
        cameras[index] = camera
    write_corrected(files.run, capture, Rig(tuple(cameras)), START)


def _prior(capture: Capture, training: list[int], settings: AdjustSettings) -> Prior:
    """Return the prior of the adjustment: for each camera, the expected standard deviations of errors in the given
    calibration."""
    given = [capture.cameras[index] for index in training]
    focus = viewing_centre(given)
    distance = np.array([float(np.linalg.norm(camera.centre - focus)) for camera in given])
    return Prior(
        np.radians(settings.rotation_deg) if settings.poses else 0.0,
        settings.position * distance if settings.poses else np.zeros(len(given)),
        settings.focal_spread if settings.focal else 0.0,
    )


def _require_no_tilt(capture: Capture) -> None:
    for name, lens in zip(capture.names, capture.distorted_cameras, strict=True):
        if lens.distortion is not None and lens.distortion[TILT:].any():
            raise UserError(
                f"{capture.path / INTRINSICS_NAME}: D_{name}: expected a sensor without tilt to refine focal lengths, "
                f"got {lens.distortion[TILT:].tolist()}; set refine.focal: false"
            )
