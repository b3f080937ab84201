"""What ``fourd make`` decided by itself, and the option that decides otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from fourd.pipeline.facts import has_masks
from fourd.reconstruction.training.run import load_run_config
from fourd.reconstruction.training.run_layout import COLOURS, CONFIG_NAME
from fourd.recording.importing.given_calibration import REPORT
from fourd.recording.importing.record import RECORD, ImportRecord, read_record


def describe_decisions(calibration: Path, imported: Path, repaired: Path, run: Path) -> tuple[str, ...]:
    """Return one line for each decision that the stages of ``fourd make`` took.

    Args:
        calibration: the folder of the calibration from a board, which may be missing.
        imported: the folder of the imported capture, which may be missing.
        repaired: the folder of the corrected capture, which may be missing.
        run: the folder of the trained run.
    """
    return tuple(_decisions(calibration, imported, repaired, run))


def _decisions(calibration: Path, imported: Path, repaired: Path, run: Path) -> Iterator[str]:
    config = load_run_config(run / CONFIG_NAME)
    if (calibration / REPORT).is_file():
        yield f"cameras: calibrated from a recording of a board ({calibration}); --calibration FOLDER uses another one"
    record = read_record(imported) if (imported / RECORD).is_file() else None
    if record is not None:
        yield from describe_offsets(record)
    if config.capture.resolve() == repaired.resolve():
        yield f"cameras: the calibration was corrected ({repaired}); fourd train on the capture uses it uncorrected"
    if (run / COLOURS).is_dir():
        corrected = "corrected for each camera; --keep-colours leaves them as they are"
        found = corrected if config.train.refine.colours else "left as they are; --refine-colours corrects them"
        yield f"colours: {found}"
    if config.train.test_views:
        held_out = ", ".join(config.train.test_views)
        yield f"held out: {held_out}; --test-views none trains on all cameras"
    if not has_masks(config.capture):
        yield "mattes: made by fourd; --method chooses how, and masks in CAPTURE/masks/ replace them"


def describe_offsets(record: ImportRecord) -> Iterator[str]:
    """Yield one line for the time offsets that an import applied, and one for those that it found but did not apply."""
    if record.options.get("sync_if_possible") or record.offsets:
        applied = ", ".join(f"{name} {frames:+g}" for name, frames in record.offsets.items() if frames)
        found = f"{applied} frames; --sync none estimates none" if applied else "none is applied"
        yield f"time offsets between the videos: {found}; --offset CAMERA=FRAMES sets them"
    if record.unsure:
        unsure = ", ".join(f"{name} {frames:+g}" for name, frames in record.unsure.items())
        option = ",".join(f"{name}={frames:g}" for name, frames in record.unsure.items())
        yield f"time offsets that are not sure: {unsure} frames are not applied; --offset {option} applies them"
