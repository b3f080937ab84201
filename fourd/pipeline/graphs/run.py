"""Selects the stages from a checked capture to a scene, and orders them by their dependencies.

The order of the stages is mattes, plates, colours, adjust, carve (or points), background, train, bake. Which stages are
needed depends on the masks of the capture and on these settings: the kind of scene, camera refinement, the user's
initial points, and segments. Segments are ranges of frames with separate models, and each has its own training stage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fourd.pipeline.facts import MaskFacts
from fourd.pipeline.graphs.capture import stages_to_hull_mattes, stages_to_mattes
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.segments import divide_stage, segment_stages, selected_frames
from fourd.pipeline.stages.bake import BakeFiles, BakeSettings, bake_stage
from fourd.pipeline.stages.cameras.adjust import AdjustSettings, adjust_stage
from fourd.pipeline.stages.cameras.colours import colours_stage, measures_colours
from fourd.pipeline.stages.mattes import MatteStageSettings
from fourd.pipeline.stages.plates import run_plates_stage
from fourd.pipeline.stages.points.background import BackgroundFiles, BackgroundSettings, background_stage
from fourd.pipeline.stages.points.carve import CarveStageSettings, carve_run_stage
from fourd.pipeline.stages.points.given_points import GivenPointSettings, given_points_stage
from fourd.pipeline.stages.still import no_points_stage
from fourd.pipeline.stages.train import TrainFiles, train_stage
from fourd.reconstruction.training.cameras.selection import DataSelection
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.matting.sequence import MatteSettings, chosen_method


@dataclass(frozen=True)
class RunRequest:
    """Description of a run to be trained.

    Attributes:
        capture: the capture's folder.
        run: the run's folder.
        train: the training config.
        points_from: folder with the user's points as FRAME.ply files, which replace the carved points. If None, the
            points are carved.
        lpips_weights: file or folder with the weights of LPIPS. If None, the default locations are searched; see
            :func:`~fourd.reconstruction.training.losses.lpips.load_lpips`.
        still: true if nothing moves in the scene, which then has no foreground; see :mod:`fourd.pipeline.stages.still`.
        accept_mattes: whether to carve even if the hull covers less than a third of the mattes' area.
    """

    capture: Path
    run: Path
    train: TrainConfig
    points_from: Path | None = None
    lpips_weights: Path | None = None
    still: bool = False
    accept_mattes: bool = False


def stages_to_first_points(request: RunRequest, *, plates: bool = True) -> tuple[AnyStage, ...]:
    """Return the stages that compute all inputs of training. The capture must have masks or mattes.

    Args:
        request: the run.
        plates: whether to include the stage that makes the run's missing plates. Pass False if another stage already
            makes them.
    """
    capture, run, train = request.capture, request.run, request.train
    selection, adjusted = DataSelection.of(train), train.refine.cameras
    stages: list[AnyStage] = []
    if measures_colours(train):
        stages.append(colours_stage(capture, run, selection))
    if adjusted:
        stages.append(adjust_stage(capture, run, AdjustSettings.of(selection, train.refine)))
    if request.still:
        stages.append(no_points_stage(capture, run, selection))
    elif request.points_from is None:
        carving = CarveStageSettings(
            selection,
            train.points,
            trim=train.trim_hull,
            inset=train.hull_inset,
            accept_mattes=request.accept_mattes,
        )
        stages.append(carve_run_stage(capture, run, carving, adjusted))
    else:
        given = GivenPointSettings(selection, train.points, train.seed)
        stages.append(given_points_stage(capture, request.points_from, run, given))
    if train.scene == "full":
        if plates:
            stages.append(run_plates_stage(capture, run, selection))
        files = BackgroundFiles(capture, run, train.background.seeds, adjusted)
        stages.append(background_stage(files, BackgroundSettings.of(train)))
    return tuple(stages)


def stages_to_run(request: RunRequest) -> tuple[AnyStage, ...]:
    """Return the stages that train a run. The capture must have masks or mattes, at least of some cameras."""
    capture, train = request.capture, request.train
    files = TrainFiles(capture, request.run, request.lpips_weights)
    made: tuple[AnyStage, ...] = ()
    masks = MaskFacts.read(capture)
    # Mattes whose method the user chose with fourd matte are kept.
    if masks.has_masks and chosen_method(capture) is None:
        made = stages_to_hull_mattes(capture, masks, train.views, train.frames, train.test_views or ())
    numbers = () if train.segments.frames is None else selected_frames(capture, train)
    return (*made, *stages_to_first_points(request), *training_stages(files, train, numbers))


def training_stages(files: TrainFiles, config: TrainConfig, numbers: Sequence[int]) -> tuple[AnyStage, ...]:
    """Return the stage that trains a run. For a run with segments, return instead the stage that divides the run into
    segments, and one training stage for each segment. ``numbers`` are the numbers of the run's frames, which only a run
    with segments needs."""
    if config.segments.frames is None:
        return (train_stage(files, config),)
    return (divide_stage(files, config), *segment_stages(files, config, numbers))


def stages_to_resume(files: TrainFiles, config: TrainConfig) -> tuple[AnyStage, ...]:
    """Return the stages that continue the training of an existing run."""
    if config.segments.frames is None:
        return (train_stage(files, config),)
    return segment_stages(files, config, selected_frames(files.capture, config))


def stages_to_scene(
    request: RunRequest,
    masks: MaskFacts,
    mattes: MatteSettings | None,
    scene: Path,
    numbers: Sequence[int] = (),
    *,
    bake: BakeSettings | None = None,
    from_hull: bool = True,
) -> tuple[AnyStage, ...]:
    """Return the stages that make the scene file ``scene`` from a capture that was already checked.

    Args:
        request: the run.
        masks: which cameras of the capture have masks from the user.
        mattes: the settings of the mattes, or None if the capture already has its mattes.
        scene: the scene file.
        numbers: the numbers of the run's frames, which only a run with segments needs.
        bake: settings of the scene file, or None for the default.
        from_hull: whether the mattes of cameras without masks are made from the masks of the other cameras.
    """
    train = request.train
    made: tuple[AnyStage, ...] = ()
    # With masks of some cameras, the run's own plates are made, as with masks of all cameras.
    plates = mattes is not None and not masks.has_masks
    if mattes is not None and masks.lacks_masks(train.views):
        settings = MatteStageSettings(train.views, train.frames, mattes)
        made = stages_to_mattes(
            request.capture, masks, settings, plates, test_views=train.test_views or (), from_hull=from_hull
        )
    prepared = stages_to_first_points(request, plates=not plates)
    trained = training_stages(TrainFiles(request.capture, request.run, request.lpips_weights), train, numbers)
    names = tuple(stage.name for stage in trained)
    files = BakeFiles(request.run, scene)
    return (*made, *prepared, *trained, bake_stage(files, bake or BakeSettings(), request.capture, names))
