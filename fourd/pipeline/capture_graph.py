"""The stages that produce a capture with mattes and plates (images of the background without the subject). None of them
needs the packages for training."""

from __future__ import annotations

import os
from pathlib import Path

from fourd.capture.calibration import INTRINSICS_NAME
from fourd.capture.layout import VIDEOS, camera_folders
from fourd.capture.pictures.alpha import alpha_is_matte
from fourd.errors import UserError, command_line
from fourd.importing.importer import ImportOptions
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.stages.import_ import import_stage
from fourd.pipeline.stages.mattes import MatteStageSettings, mattes_stage
from fourd.pipeline.stages.plates import capture_plates_stage

MASKS = "masks"


def has_masks(capture: Path) -> bool:
    """Return True if the user provided masks, in the capture's folder masks/ or in the alpha channels of its images."""
    return bool(camera_folders(capture / MASKS)) or alpha_is_matte(capture)


def is_usable(source: Path) -> bool:
    """Return True if a folder is a capture that needs no import. A capture without masks must be writable, because
    fourd stores the mattes in its folder."""
    is_capture = (source / INTRINSICS_NAME).is_file() and any((source / name).is_dir() for name in ("images", VIDEOS))
    return is_capture and (has_masks(source) or os.access(source, os.W_OK))


def stages_to_capture(source: Path, imported: Path, options: ImportOptions) -> tuple[AnyStage, ...]:
    """Return the stages that import ``source`` as a capture into the folder ``imported``.

    There are none if ``source`` is already a usable capture.

    Raises:
        UserError: if ``options`` contain a calibration, but ``source`` is a capture, which already has one.
    """
    if not is_usable(source):
        return (import_stage(source, imported, options),)
    if options.calibration is not None:
        raise UserError(
            f"--calibration: expected videos without a calibration, got the capture {source}; leave out --calibration, "
            "or import the videos with: "
            + command_line("fourd", "import", "videos", source, "CAPTURE", "--calibration", options.calibration)
        )
    return ()


def stages_to_mattes(capture: Path, settings: MatteStageSettings, plates: bool = True) -> tuple[AnyStage, ...]:
    """Return the stages that make the mattes and the plates of a capture. If the user provided masks, no stage makes
    mattes."""
    stages: list[AnyStage] = [] if has_masks(capture) else [mattes_stage(capture, settings)]
    if plates:
        stages.append(capture_plates_stage(capture, settings))
    return tuple(stages)
