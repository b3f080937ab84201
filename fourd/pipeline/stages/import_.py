"""Import: convert videos or images, with or without another program's calibration, to a capture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.importing.detection import pick_format
from fourd.importing.importer import ImportOptions, import_source
from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage

PATTERNS = ("*", "*/*", "*/*/*")


@dataclass(frozen=True)
class ImportFiles:
    """``source`` is a file or folder that ``fourd import`` can read. ``capture`` is the folder of the new capture."""

    source: Path
    capture: Path


def import_stage(source: Path, capture: Path, fps: float | None = None) -> Stage[ImportFiles, ImportOptions]:
    """Create the stage that imports ``source`` into the folder ``capture``. ``fps`` is the images' rate in 1/s."""
    return Stage(
        "import",
        run_import,
        ImportFiles(source, capture),
        ImportOptions(fps=fps),
        inputs=(Artefact(source, PATTERNS),),
        outputs=(capture,),
        leftovers=(Leftovers(capture),),
    )


def run_import(files: ImportFiles, options: ImportOptions, context: Context) -> None:
    """Detect the format of the source and import the source."""
    log = context.log
    picked = pick_format(None, files.source)
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
