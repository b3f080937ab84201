"""The stages that produce a capture with mattes and plates (images of the background without the subject). None of them
needs the packages for training."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fourd.base.errors import UserError, command_line
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.stages.hull_mattes import MIN_MASKED, MIN_MASKED_TO_SCORE, hull_matte_settings, hull_mattes_stage
from fourd.pipeline.stages.import_ import import_stage
from fourd.pipeline.stages.mattes import MatteStageSettings, mattes_stage
from fourd.pipeline.stages.plates import capture_plates_stage
from fourd.recording.capture.calibration import INTRINSICS_NAME
from fourd.recording.capture.layout import VIDEOS, camera_folders, camera_names, select_views
from fourd.recording.capture.pictures.alpha import alpha_is_matte
from fourd.recording.capture.pictures.listing import masked_cameras
from fourd.recording.importing.importer import ImportOptions

MASKS = "masks"


def has_masks(capture: Path) -> bool:
    """Return True if the user provided masks, in the capture's folder masks/ or in the alpha channels of its images."""
    return bool(camera_folders(capture / MASKS)) or alpha_is_matte(capture)


def lacks_masks(capture: Path, views: Sequence[str] | None = None) -> bool:
    """Return True if the user provided no masks of one or more of the cameras ``views``. If ``views`` is None, all
    cameras are meant."""
    return not has_masks(capture) or bool(_partly_masked(capture, views))


def _partly_masked(capture: Path, views: Sequence[str] | None) -> list[str]:
    """Return the selected cameras of a capture with masks if some of them have no masks, otherwise an empty list."""
    names, masked = select_views(views, camera_names(capture)), masked_cameras(capture)
    return [] if set(names) <= set(masked) else names


def is_usable(source: Path) -> bool:
    """Return True if a folder is a capture that needs no import. A capture without masks of all cameras must be
    writable, because fourd stores the mattes in its folder."""
    is_capture = (source / INTRINSICS_NAME).is_file() and any((source / name).is_dir() for name in ("images", VIDEOS))
    return is_capture and (not lacks_masks(source) or os.access(source, os.W_OK))


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


def stages_to_hull_mattes(
    capture: Path, views: Sequence[str] | None, frames: str | None, test_views: Sequence[str]
) -> tuple[AnyStage, ...]:
    """Return the stage that makes the mattes of cameras without masks from the masks of the other cameras.

    There is none if all cameras have masks, or if fewer than three training cameras have masks. For held-out cameras,
    the masks of two suffice, because their mattes only select the pixels that are scored.
    """
    names = _partly_masked(capture, views) if has_masks(capture) else []
    if not names:
        return ()
    held_out = _held_out(capture, views, test_views)
    settings = hull_matte_settings(capture, names, held_out, frames)
    needed = MIN_MASKED_TO_SCORE if set(settings.missing) <= set(held_out) else MIN_MASKED
    return (hull_mattes_stage(capture, settings),) if len(settings.given) >= needed else ()


def _held_out(capture: Path, views: Sequence[str] | None, test_views: Sequence[str]) -> tuple[str, ...]:
    """Return the full names of the held-out cameras among ``views``."""
    if not test_views:
        return ()
    return tuple(select_views(test_views, select_views(views, camera_names(capture)), "--test-views"))


def stages_to_mattes(
    capture: Path,
    settings: MatteStageSettings,
    plates: bool = True,
    *,
    test_views: Sequence[str] = (),
    from_hull: bool = True,
) -> tuple[AnyStage, ...]:
    """Return the stages that make the mattes and the plates of a capture.

    If the user provided masks of all selected cameras, no stage makes mattes. If the user provided masks of some
    cameras, the mattes of the others are made from these masks; see :mod:`fourd.pipeline.stages.hull_mattes`.

    Args:
        capture: the capture's folder.
        settings: the selected cameras and frames, and the method of matting.
        plates: whether to also make plates.
        test_views: held-out cameras, whose images and masks must not influence the mattes of other cameras.
        from_hull: whether masks of at least three cameras take the place of the method of ``settings``.
    """
    stages: list[AnyStage] = []
    if lacks_masks(capture, settings.views):
        hull = stages_to_hull_mattes(capture, settings.views, settings.frames, test_views) if from_hull else ()
        if not hull:
            settings = replace(settings, held_out=_held_out(capture, settings.views, test_views))
        stages += hull or (mattes_stage(capture, settings),)
    if plates:
        stages.append(capture_plates_stage(capture, settings))
    return tuple(stages)
