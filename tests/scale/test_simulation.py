"""Tests of simulated stages, and of a simulated cluster whose nodes fail."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from fourd.pipeline.runner import AnyStage, Runner
from fourd.pipeline.stage import Context
from tools.measurements.cluster.simulated_stages import Simulation, UnitCounts

ROOT = Path(__file__).resolve().parents[2]


def test_a_simulation_resumes_after_the_last_unit(tmp_path: Path) -> None:
    """Catches simulated stages that differ from the stages of fourd make, and a scene that does not depend on all
    stages. Also catches finished units that are repeated.
    """
    simulation = Simulation(tmp_path / "one", cameras=3, frames=30, segment=12, units=3, seconds=0.0)
    simulation.write_capture()
    names = [stage.name for group in simulation.groups() for stage in group]
    assert names[:7] == ["import", "check", "repair", "mattes", "plates", "carve", "segments"]
    assert names[7:] == ["train 000", "train 001", "train 002", "train 003", "bake"]
    simulation.run(Runner(Context(), simulation.folder / "stages.json"))
    # Five stages have one unit each. Mattes, plates, carving and the training of each of the four segments have three
    # units each.
    assert simulation.started_units() == 5 + 3 * 3 + 4 * 3
    counts = simulation.counts()
    assert counts["mattes"] == UnitCounts(3, 0, 0, 0)
    assert counts["train 003"] == UnitCounts(3, 0, 0, 0)

    def interrupt(stages: Sequence[AnyStage], context: Context) -> Iterator[AnyStage]:
        """Stop in the second unit of the second segment."""
        for stage in stages:
            if stage.name == "train 001":
                stage.files.count.write_text("1")
                stage.files.log.write_text("started 0 7\nfinished 0 7\nstarted 1 7\n")
                raise KeyboardInterrupt
            stage.run(context)
            yield stage

    other = replace(simulation, folder=tmp_path / "two")
    other.write_capture()
    record = other.folder / "stages.json"
    with pytest.raises(KeyboardInterrupt):
        other.run(Runner(Context(), record, interrupt))
    other.run(Runner(Context(), record))
    assert other.started_units() == simulation.started_units() + 1
    assert other.counts()["train 001"] == UnitCounts(3, 1, 1, 0)
    assert other.scene.read_text() == simulation.scene.read_text()


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="needs ray (pip install 'fourd[cluster]')")
def test_a_cluster_whose_nodes_fail_makes_the_same_scene() -> None:
    """Catches a lost node that ends the command, a scene with an incomplete segment, and a progress bar with wrong
    values."""
    words = ["--nodes", "3", "--frames", "480", "--units", "4", "--seconds", "1", "--failures", "2", "--interval", "4"]
    command = [sys.executable, "tools/measurements/cluster/simulate_cluster.py", *words]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "scene: same" in printed
    assert "to (5, 5)" in printed
