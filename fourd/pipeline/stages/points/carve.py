"""Carving: computes the initial points of each frame, and the scene's bounds, from visual hulls."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.stages.plates import MATTE_PATTERNS
from fourd.pipeline.workload import Workload
from fourd.reconstruction.carving import carve_capture
from fourd.reconstruction.carving.matte_quality import MatteQuality, measure_mattes
from fourd.reconstruction.carving.rig_evidence import check_rig
from fourd.reconstruction.training.cameras.selection import DECODED_MB, DataSelection, open_run_views
from fourd.reconstruction.training.run_layout import BACKGROUND, CALIBRATION, COLOURS, HULL, HULL_QUALITY
from fourd.recording.capture import Capture, open_capture
from fourd.recording.importing.record import describe_unsure

MIN_CAMERAS = 2
SUSPICIOUS_SHARE = 0.85
"""If the hull covers less than this fraction of the mattes' area, common mistakes of calibrations are tried."""
CARVE_S_PER_FRAME = 0.7
"""Seconds on one core to carve one frame. Measured: 0.70 s for 20 cameras and 65,536 points."""
MEASURED_FRAMES = 6
"""Number of frames whose mattes are compared with their visual hull before carving."""


@dataclass(frozen=True)
class CarveFiles:
    """Inputs and output of carving.

    Attributes:
        capture: the capture's folder.
        hull: folder to which FRAME.ply and bounds.json are written.
        run: run folder with adjusted cameras. If None, the cameras of the capture are used.
    """

    capture: Path
    hull: Path
    run: Path | None = None


@dataclass(frozen=True)
class CarveStageSettings:
    """Selected views and frames, and the parameters of carving.

    Attributes:
        selection: views and frames. Held-out views are not used.
        points: maximum number of points per frame.
        agreement: minimum fraction, in (0, 1], of mattes that must contain a hull point. Views that do not see the
            point are ignored.
        least_views: minimum fraction, in (0, 1], of all views that must see a hull point.
        trim: whether to remove protruding parts of the hull. The remaining hull still covers all silhouettes.
        inset: distance by which points are moved into the hull, in multiples of the point spacing.
        seed: seed of the random order of the points.
        accept_mattes: whether to carve even if the hull covers less than a third of the mattes' area.
    """

    selection: DataSelection
    points: int = 65536
    agreement: float = 0.95
    least_views: float = 1 / 2
    trim: bool = True
    inset: float = 0.0
    seed: int = 0
    accept_mattes: bool = False


def carve_stage(capture: Path, hull: Path, settings: CarveStageSettings) -> Stage[CarveFiles, CarveStageSettings]:
    """Create the stage that carves ``capture`` and writes the points to the folder ``hull``."""
    return Stage(
        "carve",
        run_carve,
        CarveFiles(capture, hull),
        settings,
        inputs=(Artefact(capture, INPUT_PATTERNS + MATTE_PATTERNS),),
        outputs=(hull,),
    )


def carve_run_stage(
    capture: Path, run: Path, settings: CarveStageSettings, adjusted: bool
) -> Stage[CarveFiles, CarveStageSettings]:
    """Create the stage that carves ``capture`` for a run. If ``adjusted`` is true, it uses the run's adjusted
    cameras."""
    return Stage(
        "carve",
        run_carve,
        CarveFiles(capture, run / HULL, run if adjusted else None),
        settings,
        inputs=(Artefact(capture, INPUT_PATTERNS + MATTE_PATTERNS),),
        outputs=(run / HULL,),
        leftovers=(Leftovers(run, keep=(BACKGROUND, COLOURS, *((CALIBRATION,) if adjusted else ()))),),
        after=("adjust",),
        expected_s=_expected_s,
    )


def _expected_s(settings: CarveStageSettings, workload: Workload) -> float:
    return CARVE_S_PER_FRAME * workload.known_frames / workload.workers


def run_carve(files: CarveFiles, settings: CarveStageSettings, context: Context) -> None:
    """Carve every frame. Points that an earlier call carved with the same settings are kept."""
    with _open_training_views(files, settings.selection) as opened:
        capture = opened
        if len(capture.cameras) < MIN_CAMERAS:
            raise UserError(
                f"{capture.path}: expected at least {MIN_CAMERAS} cameras, got {len(capture.cameras)}; add recordings "
                "of other cameras, or choose more --views"
            )
        capture = capture.with_mattes(context.log)
        quality = _measure_hull(capture, settings, context)
        files.hull.parent.mkdir(parents=True, exist_ok=True)
        carve_capture(
            capture,
            files.hull,
            points=settings.points,
            agreement=settings.agreement,
            least_views=settings.least_views,
            trim=settings.trim,
            inset=settings.inset,
            seed=settings.seed,
            track=context.track,
            workers=context.workers,
        )
        if quality is not None:
            quality.save(files.hull / HULL_QUALITY)


def _measure_hull(capture: Capture, settings: CarveStageSettings, context: Context) -> MatteQuality | None:
    """Measure how much of the mattes the hulls of a few frames cover.

    Raises UserError if ``accept_mattes`` is false and it is less than a third of their area, or if the mattes show that
    the calibration has a common mistake. An empty hull is not an error here, because carving reports it later and names
    the views that disagree most.
    """
    quality = measure_mattes(
        capture,
        agreement=settings.agreement,
        least_views=settings.least_views,
        max_frames=MEASURED_FRAMES,
        track=context.track,
    )
    if quality is not None and not settings.accept_mattes:
        if quality.kept_share < SUSPICIOUS_SHARE:
            check_rig(capture, verify=False).require(capture.path)
        if quality.kept_share > 0:
            quality.require_hull(capture.path, describe_unsure(capture.path))
    return quality


def _open_training_views(files: CarveFiles, selection: DataSelection) -> Capture:
    """Open the capture without the held-out views. These must not influence the scene, because they are used to
    evaluate it."""
    if not selection.test_views and files.run is None:
        views = None if selection.views is None else list(selection.views)
        return _open(files.capture, selection, views)
    with open_run_views(files.capture, selection, files.run) as run:
        cameras = [run.capture.cameras[index] for index in run.training]
        return _open(files.capture, selection, list(run.training_names)).with_cameras(cameras)


def _open(path: Path, selection: DataSelection, views: list[str] | None) -> Capture:
    return open_capture(path, views=views, frames=selection.frames, scale=selection.image_scale, cache_mb=DECODED_MB)
