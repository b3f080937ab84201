"""The list of all stages of ``fourd make``, from the source to the scene file.

Some results decide which stages follow. The list asks a :class:`Look` for them: ``fourd make`` looks at the files that
the earlier stages have written, and the plan that it prints first looks only at the source.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from fourd.base.files import resolved
from fourd.pipeline.facts import MaskFacts
from fourd.pipeline.graphs.capture import lacks_calibration, stages_to_capture
from fourd.pipeline.graphs.run import RunRequest, stages_to_scene
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.stages.bake import BakeSettings
from fourd.pipeline.stages.cameras.board import board_stage
from fourd.pipeline.stages.cameras.repair import repair_stage
from fourd.pipeline.stages.check import check_stage
from fourd.pipeline.stages.still import still_stage
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.board_calibration.search import BoardRecording
from fourd.recording.importing.importer import ImportOptions
from fourd.recording.matting.sequence import MatteSettings

CALIBRATION = "calibration"
CAPTURE = "capture"
REPAIRED = "repaired"
STILL = "still"


class Look(Protocol):
    """Tells what the stages so far have found."""

    def board(self, source: Path) -> BoardRecording | None:
        """Return the recording of a calibration board that belongs to videos without a calibration, or None."""

    def require_frames(self, capture: Path, train: TrainConfig) -> None:
        """Raise UserError if a capture lacks some of the selected cameras and frames."""

    def held_out(self, train: TrainConfig, capture: Path) -> TrainConfig:
        """Return the training config with the names of the held-out cameras."""

    def repaired(self, capture: Path, repaired: Path) -> Path:
        """Return the folder of the corrected capture if the calibration was corrected, otherwise ``capture``."""

    def still(self, capture: Path, train: TrainConfig) -> TrainConfig | None:
        """Return the training config for a still scene if nothing moves in a capture, otherwise None."""

    def masks(self, capture: Path) -> MaskFacts:
        """Return which cameras of a capture have masks from the user."""

    def mattes(self, capture: Path, masks: MaskFacts, train: TrainConfig) -> MatteSettings | None:
        """Return the settings for making mattes, or None if existing mattes are kept. From this call on, the mattes of
        the capture are reserved for this command."""

    def frame_numbers(self, capture: Path, train: TrainConfig) -> Sequence[int]:
        """Return the numbers of the selected frames."""


@dataclass(frozen=True)
class SceneStages:
    """The arguments of the list of stages.

    Attributes:
        source: a capture, or a source that ``fourd import`` can read.
        run: the run. Its field ``capture`` is not used.
        imports: options of the import.
        work: the folder for intermediate results.
        scene: the scene file.
        bake: settings of the scene file.
        finds_board: whether a recording of a calibration board beside the videos is used.
        from_hull: whether the masks of some cameras give the others their mattes.
    """

    source: Path
    run: RunRequest
    imports: ImportOptions
    work: Path
    scene: Path
    bake: BakeSettings = field(default_factory=BakeSettings)
    finds_board: bool = True
    from_hull: bool = True

    def groups(self, look: Look) -> Iterator[tuple[AnyStage, ...]]:
        """Yield the stages in groups. Each group must have run before the next is requested."""
        train, capture, imports = self.run.train, self.source, self.imports
        board = look.board(capture) if self.finds_board and lacks_calibration(capture, imports) else None
        if board is not None:
            imports = replace(imports, calibration=str(resolved(self.work / CALIBRATION)))
            yield (board_stage(board, self.work / CALIBRATION),)
        to_capture = stages_to_capture(capture, self.work / CAPTURE, imports)
        if to_capture:
            capture = self.work / CAPTURE
            yield to_capture
        yield (check_stage(capture),)
        # The repair takes minutes, so a mistake in --frames is reported before it.
        look.require_frames(capture, train)
        yield (repair_stage(capture, self.work / REPAIRED),)
        train = look.held_out(train, capture)
        capture = look.repaired(capture, self.work / REPAIRED)
        still, masks = look.still(capture, train) if self.run.points_from is None else None, look.masks(capture)
        if still is not None:
            yield (still_stage(capture, self.work / STILL),)
            train, capture, masks = still, self.work / STILL, masks.complete()
        mattes = look.mattes(capture, masks, train)
        run = replace(self.run, capture=capture, train=train, still=still is not None)
        numbers = () if train.segments.frames is None else look.frame_numbers(capture, train)
        yield stages_to_scene(run, masks, mattes, self.scene, numbers, bake=self.bake, from_hull=self.from_hull)
