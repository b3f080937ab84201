"""Carving: visual hulls from mattes give the first points of each frame and the scene's bounds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.capture import Capture, open_capture
from fourd.carving import carve_capture
from fourd.errors import UserError
from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.stages.plates import MATTE_PATTERNS
from fourd.training.cameras.selection import DECODED_MB, DataSelection, open_run_views
from fourd.training.run_layout import BACKGROUND, CALIBRATION, HULL


@dataclass(frozen=True)
class CarveFiles:
    """Inputs and output of carving.

    Attributes:
        capture: the capture's folder.
        hull: folder for FRAME.ply and bounds.json.
        run: run folder with adjusted cameras; None for the capture's cameras.
    """

    capture: Path
    hull: Path
    run: Path | None = None


@dataclass(frozen=True)
class CarveStageSettings:
    """The selection, whose held-out views are not carved from, and the parameters of carving.

    Attributes:
        points: points of each frame.
        agreement: share in (0, 1] of the views that see a point and must hold it.
        least_views: share in (0, 1] of all views that must see a point.
        seed: seed of the points' order.
    """

    selection: DataSelection
    points: int = 65536
    agreement: float = 0.95
    least_views: float = 1 / 2
    seed: int = 0


def carve_stage(capture: Path, hull: Path, settings: CarveStageSettings) -> Stage[CarveFiles, CarveStageSettings]:
    """Carve ``capture`` into the folder ``hull``."""
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
    """Carve ``capture`` for the run ``run``, with its adjusted cameras where ``adjusted``."""
    return Stage(
        "carve",
        run_carve,
        CarveFiles(capture, run / HULL, run if adjusted else None),
        settings,
        inputs=(Artefact(capture, INPUT_PATTERNS + MATTE_PATTERNS),),
        outputs=(run / HULL,),
        leftovers=(Leftovers(run, keep=(BACKGROUND, CALIBRATION) if adjusted else (BACKGROUND,)),),
        after=("adjust",),
    )


def run_carve(files: CarveFiles, settings: CarveStageSettings, context: Context) -> None:
    """Carve every frame; frames that an earlier call with the same settings finished are kept."""
    capture = _open_training_views(files, settings.selection)
    if not capture.has_masks:
        raise UserError(
            f"{capture.path}: expected masks/CAM/FRAME.png to carve from, got none; "
            f"make them: fourd matte {capture.path}"
        )
    files.hull.parent.mkdir(parents=True, exist_ok=True)
    carve_capture(
        capture,
        files.hull,
        points=settings.points,
        agreement=settings.agreement,
        least_views=settings.least_views,
        seed=settings.seed,
        track=context.track,
        workers=context.workers,
    )


def _open_training_views(files: CarveFiles, selection: DataSelection) -> Capture:
    """The capture without held-out views: they must not shape the scene that they evaluate."""
    if not selection.test_views and files.run is None:
        views = None if selection.views is None else list(selection.views)
        return _open(files.capture, selection, views)
    run = open_run_views(files.capture, selection, files.run)
    cameras = [run.capture.cameras[index] for index in run.training]
    return _open(files.capture, selection, list(run.training_names)).with_cameras(cameras)


def _open(path: Path, selection: DataSelection, views: list[str] | None) -> Capture:
    return open_capture(path, views=views, frames=selection.frames, scale=selection.image_scale, cache_mb=DECODED_MB)
