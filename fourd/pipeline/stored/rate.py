"""Rate: stores the frame rate of a source that was copied from an object store, so that all machines use the same
rate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.pipeline.stage import Context, Stage
from fourd.recording.capture.frame_rate import NAME, set_rate


@dataclass(frozen=True)
class RateFiles:
    """The capture folder, to which capture.json is written."""

    capture: Path


@dataclass(frozen=True)
class RateSettings:
    """The frame rate in 1/s."""

    fps: float


def rate_stage(capture: Path, fps: float) -> Stage[RateFiles, RateSettings]:
    """Create the stage that stores the value of the option --fps."""
    return Stage("rate", run_rate, RateFiles(capture), RateSettings(fps), outputs=(capture / NAME,))


def run_rate(files: RateFiles, settings: RateSettings, context: Context) -> None:
    """Write capture.json."""
    set_rate(files.capture, settings.fps)
