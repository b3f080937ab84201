"""Import: converts videos or images, with another program's calibration or without one, to a capture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage
from fourd.pipeline.workload import Workload
from fourd.recording.capture.layout import EXTRINSICS_NAME, INTRINSICS_NAME
from fourd.recording.importing.detection import CALIBRATION_FORMATS, pick_format
from fourd.recording.importing.given_calibration import VIDEOS_FORMAT
from fourd.recording.importing.importer import ImportOptions, import_source
from fourd.recording.importing.layouts import calibration_outside

PATTERNS = ("*", "*/*", "*/*/*")
CALIBRATION = (INTRINSICS_NAME, EXTRINSICS_NAME)


@dataclass(frozen=True)
class ImportFiles:
    """``source`` is a file or folder that ``fourd import`` can read. ``capture`` is the folder of the new capture."""

    source: Path
    capture: Path


def import_stage(source: Path, capture: Path, options: ImportOptions) -> Stage[ImportFiles, ImportOptions]:
    """Create the stage that imports ``source`` into the folder ``capture``."""
    inputs = [Artefact(source, PATTERNS)]
    outside = calibration_outside(source, CALIBRATION_FORMATS)
    if options.calibration is not None:
        inputs.append(Artefact(Path(options.calibration), CALIBRATION))
    elif outside is not None:
        inputs.append(Artefact(outside))
    return Stage(
        "import",
        run_import,
        ImportFiles(source, capture),
        options,
        inputs=tuple(inputs),
        outputs=(capture,),
        leftovers=(Leftovers(capture),),
        expected_s=_expected_s,
    )


def _expected_s(options: ImportOptions, workload: Workload) -> float:
    return workload.matching_s()


def run_import(files: ImportFiles, options: ImportOptions, context: Context) -> None:
    """Detect the format of the source, and import the source."""
    log = context.log
    picked = pick_format(None if options.calibration is None else VIDEOS_FORMAT, files.source)
    log(f"{files.source}: {picked.name}, {picked.summary}")
    import_source(
        picked,
        files.source,
        files.capture,
        options,
        log=log,
        warn=lambda line: log(f"warning: {line}"),
        track=context.track,
    )
