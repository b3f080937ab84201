"""Tests of the cost model of a cluster."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tools.measurements.cluster.cost_model import (
    Capture,
    Costs,
    Machines,
    makespan,
    predict,
    segment_core_s,
    segments_core_s,
    table,
)

COSTS = Costs.load()
STUDIO = Capture(60, 18000, 3840 * 2160 / 1e6)


def test_workers_share_the_cores_that_exist() -> None:
    """Catches a model in which four workers on two cores are four times as fast as one worker. Also catches a model
    that leaves out the jobs of an incomplete last round of workers.
    """
    works = [10.0] * 6
    assert makespan(works, slots=1, cores=2) == pytest.approx(60)
    assert makespan(works, slots=2, cores=2) == pytest.approx(30)
    # The first four jobs run at half speed for 20 s, and the last two jobs then take 10 s.
    assert makespan(works, slots=4, cores=2) == pytest.approx(30)
    assert makespan(works, slots=4, cores=4) == pytest.approx(20)
    assert makespan(works, slots=16, cores=16) == pytest.approx(10)
    assert makespan([1.0, 2.0, 3.0], slots=2, cores=2) == pytest.approx(4)
    assert makespan([], slots=2, cores=2) == 0


def test_more_nodes_shorten_only_the_training() -> None:
    """Catches a prediction that divides stages which run on one node by the number of nodes."""
    one = {stage.name: stage for stage in predict(COSTS, STUDIO, Machines(1, 16))}
    many = {stage.name: stage for stage in predict(COSTS, STUDIO, Machines(16, 16))}
    for name in ("import", "mattes", "carving", "baking"):
        assert many[name].wall_s == pytest.approx(one[name].wall_s)
    # There are 156 segments and 256 cores, so all segments are trained at the same time.
    work, start = segment_core_s(COSTS, STUDIO), COSTS.stage_start_s
    assert many["training"].wall_s == pytest.approx(work + start)
    assert one["training"].wall_s == pytest.approx(10 * work + start)
    assert all(many[name].core_s == pytest.approx(one[name].core_s) for name in one if name != "training")


def test_a_worker_starts_once() -> None:
    """Catches a model that starts a process for each segment, or that forgets the starts."""
    capture = Capture(8, 240, 0.01, segment=48, steps=100)
    work, start = segment_core_s(COSTS, capture), COSTS.stage_start_s
    assert segments_core_s(COSTS, capture, slots=1) == pytest.approx([work + start, *[work] * 5])
    assert segments_core_s(COSTS, capture, slots=2) == pytest.approx([work + start] * 2 + [work] * 4)
    assert segments_core_s(COSTS, capture, slots=9) == pytest.approx([work + start] * 6)


def test_a_table_has_the_sum_and_the_price() -> None:
    """Catches a sum that leaves out a stage, and a price for one node instead of all."""
    machines = Machines(4, 16, speed=2.0)
    stages = predict(COSTS, replace(STUDIO, has_mattes=True), machines)
    assert [stage.name for stage in stages] == ["import", "carving", "training", "baking"]
    hours = sum(stage.wall_s for stage in stages) / 3600
    lines = table(stages, machines, price=3.0).splitlines()
    assert lines[-1] == f"4 nodes for {hours:,.1f} hours: {4 * hours * 3:,.0f}"
    assert lines[-3].startswith(f"| all | {sum(stage.core_s for stage in stages) / 3600:,.1f} | {hours:,.1f} | 100% |")
