"""Facts that ``fourd info`` prints: test split and masks of a capture, and the quality of a run."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from fourd.recording.capture.split import read_test_views

if TYPE_CHECKING:
    from fourd.recording.capture import Capture


def split_and_masks(path: Path, capture: Capture) -> list[tuple[str, str]]:
    """Return the titles and texts of the facts."""
    rows, split = [], read_test_views(path)
    if split is not None:
        rows.append(("test split", ", ".join(split) or "no cameras"))
    masked = [capture.names[index] for index in capture.masked]
    some = f"of {len(masked)} cameras, not of {', '.join(name for name in capture.names if name not in masked)}"
    rows.append(("masks", "yes" if capture.has_masks else some if masked else "none"))
    return rows


def quality_lines(path: Path) -> Iterable[str]:
    """Yield the held-out quality of a run, and warnings about it."""
    from fourd.pipeline.report.summary import summarize_run

    summary = summarize_run(path)
    return [*summary.lines, *(f"warning: {line}" for line in summary.warnings)] or ["no held-out score yet"]
