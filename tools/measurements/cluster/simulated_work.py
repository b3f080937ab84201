"""Runs the work of a simulated stage, which consists of units that only wait. Because the workers of a cluster import
this module, it imports only few others."""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import dataclass
from pathlib import Path

from fourd.base.files import write_text_atomically
from fourd.pipeline.stage import Context

STARTED, FINISHED = "started", "finished"


@dataclass(frozen=True)
class SimulatedFiles:
    """The files of a simulated stage.

    Attributes:
        folder: the folder with the outputs of all stages.
        name: the name of the stage.
        inputs: the names of the stages whose outputs it reads.
    """

    folder: Path
    name: str
    inputs: tuple[str, ...]

    @property
    def output(self) -> Path:
        return self.folder / self.name

    @property
    def log(self) -> Path:
        """Path of the log. Each start and each end of a unit (see :class:`SimulatedSettings`) adds one line with the
        process id. A unit that was lost is started again, so it has several start lines."""
        return self.folder / f"{self.name}.log"

    @property
    def count(self) -> Path:
        """Path of the file that contains the number of finished units."""
        return self.folder / f"{self.name}.count"


@dataclass(frozen=True)
class SimulatedSettings:
    """The number of units of a simulated stage, and the waiting time of each unit in seconds. A unit is the part of the
    stage's work between two checkpoints."""

    units: int
    seconds: float


def work(files: SimulatedFiles, settings: SimulatedSettings, context: Context) -> None:
    """Simulate the work of a stage: sleep once for each unit of work that is not finished yet, and then write the
    stage's output."""
    done = int(files.count.read_text()) if files.count.exists() else 0
    for unit in range(done, settings.units):
        _log(files.log, STARTED, unit)
        time.sleep(settings.seconds)
        write_text_atomically(files.count, str(unit + 1))
        _log(files.log, FINISHED, unit)
    read = [(files.folder / name).read_text() for name in files.inputs]
    hashed = hashlib.sha256("\n".join([files.name, str(settings.units), *read]).encode())
    write_text_atomically(files.output, hashed.hexdigest())


def _log(path: Path, event: str, unit: int) -> None:
    with path.open("a") as log:
        log.write(f"{event} {unit} {os.getpid()}\n")
