"""Replaces the work of the stages of ``fourd make`` by waiting, to simulate clusters and captures that are too large
for the machine.

The stage graph, the runner and its record of finished stages, and the tasks of the cluster are the same as in ``fourd
make``. The work of a stage consists of units. A unit stands for the work between two checkpoints: the stage waits, and
then records the unit in a file. A repeated stage continues after the last recorded unit. The output of a stage is a
hash of its name, its number of units and the outputs of the earlier stages. The scene, which is the output of the stage
"bake", is therefore correct only if each stage has read complete outputs.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fourd.base.processes import locked_folder
from fourd.pipeline.facts import MaskFacts
from fourd.pipeline.graphs.capture import stages_to_capture
from fourd.pipeline.graphs.run import RunRequest, stages_to_scene
from fourd.pipeline.runner import AnyStage, Runner
from fourd.pipeline.stage import Stage
from fourd.pipeline.stages.cameras.repair import repair_stage
from fourd.pipeline.stages.check import check_stage
from fourd.reconstruction.training.config import SegmentConfig, TrainConfig
from fourd.recording.capture import write_calibration
from fourd.recording.capture.layout import VIDEOS
from fourd.recording.importing.importer import ImportOptions
from fourd.recording.matting.sequence import MatteSettings
from tests.captures import ring_cameras
from tools.measurements.cluster.simulated_work import STARTED, SimulatedFiles, SimulatedSettings, work
from tools.measurements.long_set import write_video

SIZE = 32
"""Side of the captured images in pixels. They are small, because the simulated stages do not read them."""


@dataclass(frozen=True)
class UnitCounts:
    """Counts how often the units of one or more stages were executed. A unit is the part of a stage's work between two
    checkpoints.

    Attributes:
        units: number of units.
        lost: number of executions that were interrupted because the process was killed.
        repeated: number of executions, not counting the first execution of each unit.
        redone: number of executions that were unnecessary, because an earlier execution had finished the unit.
    """

    units: int
    lost: int
    repeated: int
    redone: int


@dataclass(frozen=True)
class Simulation:
    """A capture with a given number of cameras and frames, and the durations of its stages.

    Attributes:
        folder: folder with the capture and the outputs of the stages. :meth:`write_capture` writes the capture.
        cameras: number of cameras.
        frames: number of frames.
        segment: maximum number of frames of a segment.
        units: number of units (parts of a stage's work between two checkpoints) in the training of one segment. The
            stages "mattes" and "plates" have one unit per camera, "carve" has one unit per segment, and the other
            stages have a single unit.
        seconds: waiting time of a unit in seconds.
    """

    folder: Path
    cameras: int
    frames: int
    segment: int
    units: int
    seconds: float

    @property
    def outputs(self) -> Path:
        return self.folder / "outputs"

    @property
    def scene(self) -> Path:
        return self.outputs / "bake"

    def write_capture(self) -> None:
        """Write videos with the given number of small, black frames, and a calibration."""
        black, names = np.zeros((SIZE, SIZE, 3), np.uint8), [f"{camera:02d}" for camera in range(self.cameras)]
        first = self._capture / VIDEOS / f"{names[0]}.mp4"
        write_video(first, [black], [0] * self.frames, 30)
        for name in names[1:]:
            os.link(first, first.with_name(f"{name}.mp4"))
        write_calibration(self._capture, names, ring_cameras(self.cameras, SIZE))

    def groups(self) -> list[list[AnyStage]]:
        """Return the stages of ``fourd make`` with simulated work, in the groups in which ``fourd make`` runs them."""
        train = TrainConfig(segments=SegmentConfig(frames=self.segment))
        request = RunRequest(self._capture, self.folder / "run", train)
        imported = stages_to_capture(self.folder / "videos", self._capture, ImportOptions())
        checked = (check_stage(self._capture), repair_stage(self._capture, self.folder / "repaired"))
        numbers = range(self.frames)
        scene = stages_to_scene(
            request, MaskFacts.read(self._capture), MatteSettings(), self.folder / "scene.4dv", numbers
        )
        before: list[str] = []
        return [self._simulated(stages, before) for stages in (imported, checked, scene)]

    def run(self, runner: Runner) -> None:
        """Lock the output folder and run all stages in it, as ``fourd make`` does."""
        self.outputs.mkdir(parents=True, exist_ok=True)
        with locked_folder(self.outputs):
            for group in self.groups():
                runner.run(group)

    def started_units(self) -> int:
        """Return the number of times that units of all stages were started. A unit that was lost and repeated counts
        twice."""
        return sum(counts.units + counts.repeated for counts in self.counts().values())

    def counts(self) -> dict[str, UnitCounts]:
        """Return the unit counts of each stage, by stage name."""
        stages = [stage for group in self.groups() for stage in group]
        return {stage.name: _count(stage.files.log, stage.settings.units) for stage in stages}

    @property
    def _capture(self) -> Path:
        return self.folder / "capture"

    def _simulated(self, stages: Sequence[AnyStage], before: list[str]) -> list[AnyStage]:
        """Replace the work of the given stages by simulated work. Segment training reads only the outputs of the stages
        on which it depends; the other stages read the outputs of all earlier stages."""
        simulated = []
        for stage in stages:
            inputs = stage.after if stage.is_parallel else tuple(before)
            files = SimulatedFiles(self.outputs, stage.name, inputs)
            settings = SimulatedSettings(self._units(stage), self.seconds)
            after, is_parallel = stage.after, stage.is_parallel
            replaced = Stage(stage.name, work, files, settings, outputs=(files.output,), after=after)
            simulated.append(replace(replaced, is_parallel=is_parallel))
            before.append(stage.name)
        return simulated

    def _units(self, stage: AnyStage) -> int:
        if stage.is_parallel:
            return self.units
        segments = -(-self.frames // self.segment)
        return {"mattes": self.cameras, "plates": self.cameras, "carve": segments}.get(stage.name, 1)


def _count(log: Path, units: int) -> UnitCounts:
    started = ended = redone = 0
    finished: set[str] = set()
    for line in log.read_text().splitlines():
        event, unit, _ = line.split()
        if event == STARTED:
            started += 1
            redone += unit in finished
        else:
            ended += 1
            finished.add(unit)
    return UnitCounts(units, started - ended, started - units, redone)
