"""The JSON data that the page of a run shows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fourd.reconstruction.training.evaluation.held_out import read_score
from fourd.reconstruction.training.live.state import Phase, TrainingState, is_training, read_state
from fourd.reconstruction.training.run_layout import CHECKPOINTS, VALIDATION, segment_folders
from fourd.viewer.publish.runs.history import RunHistory

MAX_PICTURES = 24
"""Maximum number of validation images that the page offers."""
_LEAST_SHARE = 1e-6
"""Fraction of the training's step or time budget that must be spent before the remaining time is estimated."""
_DIGITS = 12
"""Maximum number of digits of the step in the file name of a validation image."""

ShownPhase = Phase | Literal["ended", "idle"]
"""The phase of a run. ``ended`` means that no process trains the run, although the phase in its state file is still
"training" or "paused", for example because the process was killed. ``idle`` means that the run has no valid state file.
"""


@dataclass(frozen=True)
class ActiveRun:
    """The run or segment that is training, or that trained last. Segments are ranges of frames with separate models.

    Attributes:
        folder: the folder of the run or the segment.
        segment: number of the segment, counted from 1, or None for a run without segments.
        state: the last state of the training.
        is_alive: whether the training process is running.
    """

    folder: Path
    segment: int | None
    state: TrainingState | None
    is_alive: bool

    @property
    def phase(self) -> ShownPhase:
        """The phase that the page shows."""
        if self.state is None:
            return "idle"
        is_over = self.state.phase not in ("training", "paused")
        return self.state.phase if is_over or self.is_alive else "ended"


def find_active(run: Path) -> ActiveRun:
    """Return the run or segment that is training or, if none is, the one with the newest state."""
    folders = segment_folders(run)
    parts = [_active(folder, index) for index, folder in enumerate(folders, 1)] or [_active(run, None)]
    known = [part for part in parts if part.state is not None]
    return max(known, key=lambda part: (part.is_alive, part.state.updated if part.state else 0.0), default=parts[0])


def picture_steps(run: Path, last: int) -> list[int]:
    """Return the steps of the newest validation images up to the step ``last``, in ascending order.

    Images of later steps are left out. They exist if the training was killed some steps after its last checkpoint and
    then resumed from this checkpoint. These images were written before the training was killed, and the resumed
    training has not reached their steps yet.
    """
    names = [path.stem for path in (run / VALIDATION).glob("*.png")]
    steps = sorted(int(name) for name in names if name.isdecimal() and len(name) <= _DIGITS)
    return [step for step in steps if step <= last][-MAX_PICTURES:]


def describe(title: str, active: ActiveRun, history: RunHistory) -> dict[str, Any]:
    """Return the state of a run, without its curves."""
    state, phase = active.state, active.phase
    seconds = (state.seconds if state else history.last("seconds")) or 0.0
    step = state.step if state else history.step
    remaining = None
    if state is not None and state.spent >= _LEAST_SHARE and phase in ("training", "paused"):
        remaining = seconds * (1 / state.spent - 1)
    return {
        "title": title,
        "segment": active.segment,
        "session": state.session if state else "",
        "phase": phase,
        "reason": state.reason if state else "",
        "step": step,
        "max_steps": state.max_steps if state else None,
        "spent": state.spent if state else None,
        "seconds": seconds,
        "remaining_seconds": remaining,
        "is_held_out": state.is_held_out if state else True,
        "psnr": history.last("psnr_smooth"),
        "held_out": _held_out(active.folder),
        "validation_psnr": history.last("validation/psnr"),
        "pictures": picture_steps(active.folder, step),
        "broken_lines": history.broken,
    }


def _held_out(run: Path) -> str:
    """Return the held-out score of a run in words, or an empty text if it was not measured yet."""
    score = read_score(run / CHECKPOINTS)
    if score is None:
        return ""
    warning = score.warning()
    return score.describe() + (f". Warning: {warning}." if warning else "")


def _active(folder: Path, segment: int | None) -> ActiveRun:
    state = read_state(folder)
    return ActiveRun(folder, segment, state, state is not None and is_training(folder, state))
