"""Facts that ``fourd info`` prints: test split and masks of a capture, and the quality of a run."""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeGuard

from fourd.base.limits import open_regular
from fourd.base.progress import format_minutes
from fourd.recording.capture.split import read_test_views

if TYPE_CHECKING:
    from fourd.recording.capture import Capture

_MOST_VALUE = 1e300


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


def last_metrics(path: Path) -> list[str]:
    """Describe the last complete line of metrics.jsonl: in words, or with its first eight numbers if it does not have
    the numbers of a training step.

    Returns a list with one line of text, or an empty list if there is no complete line.
    """
    if not path.is_file():
        return []
    with open_regular(path) as stream:
        stream.seek(max(0, path.stat().st_size - (64 << 10)))
        lines = stream.read().splitlines()
    for line in reversed(lines):
        values = None
        with suppress(ValueError, RecursionError):
            values = json.loads(line)
        if isinstance(values, dict):
            quality, step, seconds = (values.get(name) for name in ("psnr_smooth", "step", "seconds"))
            if _is_number(quality) and _is_number(step) and _is_number(seconds):
                return [f"step {step:g} after {format_minutes(seconds)}: {quality:.1f} dB on training views"]
            shown = [f"{key[:40]} {value:g}" for key, value in values.items() if _is_number(value)]
            return [", ".join(shown[:8])]
    return []


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and abs(value) < _MOST_VALUE
