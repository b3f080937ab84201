"""Inputs and reports of the benchmarks, with small workloads. The kernels have separate tests."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console

from fourd.benchmarks.cases import composite
from fourd.benchmarks.machine import this_machine
from fourd.benchmarks.meshes import antialiasing, interpolating, make_mesh, project, rasterizing
from fourd.benchmarks.report import Row, markdown, to_json
from fourd.benchmarks.textures import make_textured_plane, trilinear_texture
from fourd.benchmarks.timing import Clock, Timing
from fourd.benchmarks.training_profile import profile_training, serial_share, tables
from fourd.benchmarks.workloads import make_baked_frame, make_camera, make_cloud, make_planes
from fourd.cli.main import main
from fourd.pipeline.make import create_run
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.synth import make_synthetic
from fourd.rendering.ops.planes.op import sample_planes
from fourd.rendering.triangles import rasterize
from fourd.scene.player import Player


def test_points_cover_the_middle_of_the_picture() -> None:
    """Catches points outside the image, for which a timing would be meaningless."""
    frame, scene = make_baked_frame(20_000)
    picture = Player().draw(frame, make_camera(192, 108), scene)
    alpha = picture[..., 3] / 255
    assert 0.15 < (alpha > 0.5).mean() < 0.6
    assert alpha[54, 96] > 0.95
    assert alpha[2, 2] == 0
    assert picture[..., :3].std() > 5


def test_backward_work_computes_gradients() -> None:
    """Catches a backward pass that is never executed."""
    cloud, view = make_cloud(500), make_camera(40, 40)
    image = composite(cloud, view, 5, False)()
    gradients = composite(cloud, view, 5, True)()
    assert image.features.shape == (40, 40, 3)  # type: ignore[attr-defined]
    assert [gradient.shape for gradient in gradients] == [array.shape for array in cloud.values()]  # type: ignore[attr-defined]
    assert all(gradient.abs().max() > 0 for gradient in gradients)  # type: ignore[attr-defined]
    tensors, axes = make_planes(side=4, levels=2, features=3, frames=5)
    assert sample_planes(torch.zeros(2, 4), tensors, axes).shape == (2, 36)


def test_triangles_cover_half_of_the_picture() -> None:
    """Catches a mesh outside the image, for which a timing would be meaningless, and gradients that are zero."""
    xyz, tri = make_mesh(2_000)
    assert 1_900 < len(tri) < 2_100
    rast = rasterize(project(xyz, 64), tri, (64, 64))[0]
    assert 0.3 < float((rast[..., 3] > 0).float().mean()) < 0.7
    assert float(rasterizing(2_000, 64, True)()[0].abs().max()) > 0  # type: ignore[index]
    assert [float(gradient.abs().max()) > 0 for gradient in interpolating(2_000, 64, True)()] == [True, True]  # type: ignore[attr-defined]


@pytest.mark.parametrize("changes_image", [True, False])
def test_silhouettes_have_gradients(changes_image: bool) -> None:
    """Catches a benchmark of antialiasing without silhouettes, whose gradients are zero."""
    to_color, to_pos = antialiasing(2_000, 64, changes_image=changes_image)()  # type: ignore[misc]
    assert to_color.abs().max() > 0
    assert to_pos.abs().max() > 0


def test_clock_reports_units() -> None:
    """Catches an inverted ratio to the unit, and limits on the number of runs that are ignored."""
    timing = Clock(seconds=0.01, min_runs=3, max_runs=3).time(lambda: np.linalg.norm(np.ones(10)))
    assert timing.runs == 3
    assert 0 < timing.units < 1


def test_reports_contain_every_timing() -> None:
    """Catches an inverted ratio between a rival's time and the time of the work."""
    rows = [Row("work", Timing(10.0, 0.5, 7), {"other": Timing(40.0, 2.0, 3)})]
    machine = this_machine()
    text = markdown(rows, machine)
    assert "| work | 10.0 | 0.500 | other 40 ms (4.0 times as long) |" in text
    assert str(machine) in text
    content = json.loads(to_json(rows, machine))
    assert content["machine"]["threads"] >= 1
    assert content["rows"][0]["timing"] == {"ms": 10.0, "units": 0.5, "runs": 7}
    assert content["rows"][0]["rivals"]["other"]["ms"] == 40.0


@pytest.mark.slow
def test_quick_bench_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a benchmark table without rows, and result files that differ from the table."""
    words = ["bench", "--quick", "--json", str(tmp_path / "b.json"), "--markdown", str(tmp_path / "b.md")]
    assert main(words) == 0
    shown = capsys.readouterr().out
    content = json.loads((tmp_path / "b.json").read_text())
    assert len(content["rows"]) >= 5
    assert all(row["timing"]["ms"] > 0 for row in content["rows"])
    assert "K-Planes" in shown
    if find_spec("pytorch3d") is None:
        assert "pytorch3d is not installed, so no row compares fourd with pytorch3d." in shown
    assert (tmp_path / "b.md").read_text().count("\n| ") == len(content["rows"]) + 1


def test_the_textured_plane_needs_mip_levels() -> None:
    """Catches a backward pass that computes no gradients. Also catches a benchmark whose footprints are all smaller
    than a texel, so that no mip levels are blended.
    """
    plane = make_textured_plane(64)
    by_x, by_y = plane["uv_da"].unflatten(-1, (2, 2)).unbind(-1)
    longer = 64 * torch.maximum(by_x.norm(dim=-1), by_y.norm(dim=-1))
    assert 0.9 < float(longer.min()) < 1.2
    assert 4 < float(longer.max()) < 5
    assert trilinear_texture(32, False)().shape == (1, 32, 32, 3)  # type: ignore[attr-defined]
    assert all(gradient.abs().max() > 0 for gradient in trilinear_texture(32, True)())  # type: ignore[attr-defined]


def test_serial_share_follows_amdahls_law() -> None:
    """Catches a wrong formula: half of the work on one thread makes two threads 4/3 times as fast."""
    assert serial_share(100, 75, 2) == pytest.approx(0.5)
    assert serial_share(100, 100 / 8, 8) == pytest.approx(0)


def test_training_profile_counts_the_operators_of_a_step(tmp_path: Path) -> None:
    """Catches steps without operators, backward operators that are counted as forward ones, and times per step that are
    sums over all steps."""
    make_synthetic(tmp_path / "capture", frames=1, cameras=4, size=64, seed=0)
    config = TrainConfig(points=500, max_steps=10)
    run = create_run(tmp_path / "capture", tmp_path / "run", config)
    found = profile_training(run, config, torch.device("cpu"), steps=2)
    heads = next(row for row in found.operators if row.name == "fourd::evaluate_heads")
    assert heads.forward_ms > 0
    assert heads.backward_ms > 0
    assert heads.events > 2
    assert 50 < sum(row.events for row in found.operators) <= found.events < 3000
    assert found.between_ms > 0
    assert min(found.step_ms) == 1
    assert found.gpu is None
    assert not list((tmp_path / "run" / "checkpoints").glob("*.safetensors"))
    console = Console(width=120, record=True)
    for table in tables(found):
        console.print(table)
    assert "fourd::evaluate_heads" in console.export_text()
