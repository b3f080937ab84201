"""The last lines of ``fourd train`` and ``fourd make``: the measured quality of a run, and warnings about it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.reconstruction.carving.matte_quality import HullShare, read_hull_share
from fourd.reconstruction.training.evaluation.held_out import HeldOutScore, read_score
from fourd.reconstruction.training.run_layout import CHECKPOINTS, HULL, HULL_QUALITY, segment_folders

MIN_HULL_SHARE = 0.7
"""If the visual hull covers less than this fraction of the mattes' area, the summary has a warning."""


@dataclass(frozen=True)
class RunSummary:
    """The quality of a run in words.

    Attributes:
        lines: the measured quality, one line for each measurement.
        warnings: what is wrong, and what to do, one line each.
        decisions: what ``fourd make`` decided by itself, and the option that decides otherwise, one line each.
    """

    lines: tuple[str, ...]
    warnings: tuple[str, ...]
    decisions: tuple[str, ...] = ()


def summarize_run(run: Path) -> RunSummary:
    """Summarize a run, or all segments of a run with segments, from the measurements in its folder."""
    lines, warnings = _held_out(run)
    hull = read_hull_share(run / HULL / HULL_QUALITY)
    if hull is not None:
        lines.append(f"mattes: the visual hull covers {hull.kept_share:.0%} of their area")
        if hull.kept_share < MIN_HULL_SHARE:
            warnings.append(_hull_warning(run, hull))
    return RunSummary(tuple(lines), tuple(warnings))


def _held_out(run: Path) -> tuple[list[str], list[str]]:
    """Return the held-out score in words, and the warnings. For a run with segments, they describe the segment with the
    largest difference between training views and held-out views."""
    folders = segment_folders(run) or [run]
    found = [(folder, score) for folder in folders if (score := read_score(folder / CHECKPOINTS)) is not None]
    if not found:
        return [], []
    folder, worst = max(found, key=lambda each: (each[1].kind != "none", each[1].gap_db))
    place = "" if folder == run else f"segment {folder.name}, the worst of {len(folders)}: "
    lines = [place + worst.describe()]
    if len(found) > 1:
        lines.append(_mean([score for _, score in found]))
    warning = worst.warning()
    return [line for line in lines if line], [f"{folder}: {warning}"] if warning else []


def _mean(scores: list[HeldOutScore]) -> str:
    measured = [score for score in scores if score.kind != "none"]
    if len(measured) < 2:
        return ""
    held_out = sum(score.psnr for score in measured) / len(measured)
    training = sum(score.training_psnr for score in measured) / len(measured)
    return f"mean of {len(measured)} segments: held out {held_out:.1f} dB; training views {training:.1f} dB"


def _hull_warning(run: Path, hull: HullShare) -> str:
    worst = f" (worst: {hull.poor[0]})" if hull.poor else ""
    return (
        f"{run}: the visual hull covers only {hull.kept_share:.0%} of the area of the mattes{worst}, so parts of the "
        "subject are missing; fix the mattes (docs/matting.md) or the calibration (fourd check CAPTURE), or leave out "
        "bad cameras with --views"
    )
