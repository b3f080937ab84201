"""Plates: for each camera, computes an image of the background without the subject, from the camera's images and
mattes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.stages.mattes import MatteFiles, MatteStageSettings
from fourd.reconstruction.background.plates import USER_FOLDER, has_plate
from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views
from fourd.reconstruction.training.run_layout import BACKGROUND, PLATES, POINTS
from fourd.recording.capture.video_index import index_capture
from fourd.recording.matting.plates import FOLDER as CAPTURE_PLATES
from fourd.recording.matting.plates import make_plates
from fourd.recording.matting.selection import Selection
from fourd.recording.matting.sequence import matte_key

MATTE_PATTERNS = (".fourd/mattes/*/*",)
PLATE_PATTERNS = (f"{USER_FOLDER}/*", f"{CAPTURE_PLATES.as_posix()}/*")
RUN_KEY = "run"
"""Constant cache key of the plates in a run folder. (In a capture folder, the key depends on the settings of the
mattes.)"""


@dataclass(frozen=True)
class RunPlateFiles:
    """The folders of the capture and of the run. The plates are written to ``background/plates/`` in the run folder."""

    capture: Path
    run: Path


def capture_plates_stage(capture: Path, settings: MatteStageSettings) -> Stage[MatteFiles, MatteStageSettings]:
    """Create the stage that makes the plates of ``capture`` in its subfolder ``.fourd/plates``."""
    return Stage(
        "plates",
        make_capture_plates,
        MatteFiles(capture),
        settings,
        inputs=(Artefact(capture, INPUT_PATTERNS + MATTE_PATTERNS),),
        outputs=(capture / CAPTURE_PLATES,),
        after=("mattes",),
    )


def make_capture_plates(files: MatteFiles, settings: MatteStageSettings, context: Context) -> None:
    """Make missing plates. Existing plates are kept if they were made from the same mattes. Held-out cameras need
    none."""
    used, _ = settings.split(files.capture)
    index_capture(files.capture, used, context.track)
    selection = Selection(files.capture, used, settings.frames)
    with selection.open() as capture:
        key = matte_key(capture, settings.mattes)
    make_plates(selection, key, context.workers, context.track)


def run_plates_stage(capture: Path, run: Path, selection: DataSelection) -> Stage[RunPlateFiles, DataSelection]:
    """Create the stage that makes plates for the training views of a run, unless the capture has a plate for each of
    them."""
    return Stage(
        "plates",
        make_run_plates,
        RunPlateFiles(capture, run),
        selection,
        inputs=(Artefact(capture, INPUT_PATTERNS + MATTE_PATTERNS + PLATE_PATTERNS),),
        outputs=(run / BACKGROUND,),
        leftovers=(Leftovers(run / BACKGROUND, keep=(POINTS,)),),
    )


def make_run_plates(files: RunPlateFiles, selection: DataSelection, context: Context) -> None:
    """Make clean plates for all training views, unless the capture has a plate for each of them. Held-out views are not
    used."""
    folder = files.run / BACKGROUND
    folder.mkdir(parents=True, exist_ok=True)
    with open_run_views(files.capture, selection) as views:
        names = views.training_names
    if all(has_plate(files.capture, name) for name in names):
        return
    part = Selection(files.capture, names, selection.frames)
    make_plates(part, RUN_KEY, context.workers, context.track, folder / PLATES)
