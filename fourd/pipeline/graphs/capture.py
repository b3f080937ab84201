"""The stages that produce a capture with mattes and plates (images of the background without the subject). None of them
needs the packages for training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fourd.base.errors import UserError, command_line
from fourd.pipeline.facts import MASKS, MaskFacts, is_usable
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.stages.hull_mattes import MIN_MASKED, MIN_MASKED_TO_SCORE, HullMatteSettings, hull_mattes_stage
from fourd.pipeline.stages.import_ import import_stage
from fourd.pipeline.stages.mattes import MatteStageSettings, mattes_stage
from fourd.pipeline.stages.plates import capture_plates_stage
from fourd.recording.capture.layout import MATTES, select_views
from fourd.recording.capture.video_list import NAME as VIDEO_LIST
from fourd.recording.importing.detection import pick_format
from fourd.recording.importing.given_calibration import VIDEOS_FORMAT
from fourd.recording.importing.importer import ImportOptions
from fourd.recording.importing.record import RECORD


def needs_import(source: Path, options: ImportOptions) -> bool:
    """Return whether a source must be imported: whether it is no usable capture, or a folder of calibrated videos that
    fourd has not imported, and whose time offsets are given or are to be estimated. Mattes in it belong to unshifted
    videos, so a folder with mattes is used as it is."""
    if not is_usable(source):
        return True
    is_known = any((source / name).exists() for name in (RECORD, VIDEO_LIST, MATTES, MASKS, "images"))
    return (options.sync_if_possible or bool(options.offsets)) and not is_known


def lacks_calibration(source: Path, options: ImportOptions) -> bool:
    """Return whether a source consists of videos or images for which neither the source nor the user has a calibration.

    Raises:
        UserError: if the source has no known format.
    """
    if options.calibration is not None or not needs_import(source, options):
        return False
    return pick_format(None, source).name == VIDEOS_FORMAT


def stages_to_capture(source: Path, imported: Path, options: ImportOptions) -> tuple[AnyStage, ...]:
    """Return the stage that imports ``source`` as a capture into the folder ``imported``, if it must be imported.

    Raises:
        UserError: if ``options`` contain a calibration, but ``source`` is a capture, which already has one, or if they
            contain time offsets for a capture, whose frames are already aligned.
    """
    if options.calibration is not None and is_usable(source):
        raise UserError(
            f"--calibration: expected videos without a calibration, got the capture {source}; leave out --calibration, "
            "or import the videos with: "
            + command_line("fourd", "import", "videos", source, "CAPTURE", "--calibration", options.calibration)
        )
    if not needs_import(source, options):
        if options.offsets:
            raise UserError(
                f"--offset: expected videos, got the capture {source}, whose frames are aligned; import its videos "
                "again with fourd import --offset"
            )
        return ()
    return (import_stage(source, imported, options),)


def stages_to_hull_mattes(
    capture: Path, masks: MaskFacts, views: Sequence[str] | None, frames: str | None, test_views: Sequence[str]
) -> tuple[AnyStage, ...]:
    """Return the stage that makes the mattes of cameras without masks from the masks of the other cameras.

    There is none if all cameras have masks, or if fewer than three training cameras have masks. For held-out cameras,
    the masks of two suffice, because their mattes only select the pixels that are scored.
    """
    names = masks.partly_masked(views) if masks.has_masks else []
    if not names:
        return ()
    held_out = _held_out(masks.cameras, views, test_views)
    given = tuple(name for name in names if name in masks.masked and name not in held_out)
    settings = HullMatteSettings(given, tuple(name for name in names if name not in masks.masked), frames)
    needed = MIN_MASKED_TO_SCORE if set(settings.missing) <= set(held_out) else MIN_MASKED
    return (hull_mattes_stage(capture, settings),) if len(settings.given) >= needed else ()


def _held_out(cameras: Sequence[str], views: Sequence[str] | None, test_views: Sequence[str]) -> tuple[str, ...]:
    """Return the full names of the held-out cameras among ``views``."""
    return tuple(select_views(test_views, select_views(views, cameras), "--test-views")) if test_views else ()


def stages_to_mattes(
    capture: Path,
    masks: MaskFacts,
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
        masks: which cameras have masks.
        settings: the selected cameras and frames, and the method of matting.
        plates: whether to also make plates.
        test_views: held-out cameras, whose images and masks must not influence the mattes of other cameras.
        from_hull: whether masks of at least three cameras take the place of the method of ``settings``.
    """
    stages: list[AnyStage] = []
    held_out = _held_out(masks.cameras, settings.views, test_views)
    if masks.lacks_masks(settings.views):
        hull = stages_to_hull_mattes(capture, masks, settings.views, settings.frames, test_views) if from_hull else ()
        if not hull:
            settings = replace(settings, held_out=held_out)
        stages += hull or (mattes_stage(capture, settings),)
    if plates:
        stages.append(capture_plates_stage(capture, settings))
    return tuple(stages)
