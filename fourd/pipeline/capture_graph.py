"""The stages up to a capture with mattes and plates. They need no training packages."""

from __future__ import annotations

import os
from pathlib import Path

from fourd.capture.calibration import INTRINSICS_NAME
from fourd.capture.layout import VIDEOS, camera_folders
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.stages.import_ import import_stage
from fourd.pipeline.stages.mattes import MatteStageSettings, mattes_stage
from fourd.pipeline.stages.plates import capture_plates_stage

MASKS = "masks"


def has_masks(capture: Path) -> bool:
    """Whether a capture has its own masks in masks/."""
    return bool(camera_folders(capture / MASKS))


def is_usable(source: Path) -> bool:
    """Whether a folder is a capture that needs no import. The folder must contain masks, or be writable so that mattes
    can be stored in it."""
    is_capture = (source / INTRINSICS_NAME).is_file() and any((source / name).is_dir() for name in ("images", VIDEOS))
    return is_capture and (has_masks(source) or os.access(source, os.W_OK))


def stages_to_capture(source: Path, imported: Path) -> tuple[AnyStage, ...]:
    """Stages from any source to a capture in the folder ``imported``; empty if ``source`` is a usable capture."""
    return () if is_usable(source) else (import_stage(source, imported),)


def stages_to_mattes(capture: Path, settings: MatteStageSettings, plates: bool = True) -> tuple[AnyStage, ...]:
    """Stages that make mattes and plates. Mattes are not made if the capture has its own masks."""
    stages: list[AnyStage] = [] if has_masks(capture) else [mattes_stage(capture, settings)]
    if plates:
        stages.append(capture_plates_stage(capture, settings))
    return tuple(stages)
