"""Points that come where the error is and go where nothing shows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file

from fourd.training.background import outside_all_images
from fourd.training.config import DensifyConfig
from fourd.training.points.densification import accumulate_gradient_magnitudes, densify, unobserved_points
from fourd.training.points.frame_points import FramePoints
from fourd.training.run import points_folder
from tests.captures import ring_cameras
from tests.training.small import full_config, trained_run

CONFIG = DensifyConfig(share=0.1, growth=1.25)


def sheet(side: int = 20, *, colours: bool = True) -> FramePoints:
    """side * side points a centimetre apart on z = 0, their x as red."""
    x, y = torch.meshgrid(torch.arange(side) * 0.01, torch.arange(side) * 0.01, indexing="ij")
    xyz = torch.stack([x, y, torch.zeros_like(x)], -1).reshape(-1, 3).float()
    rgb = xyz / xyz.max() if colours else None
    return FramePoints.fresh(xyz, torch.full((side * side,), 0.01), 1.3, explicit_sh=False, rgb=rgb)


def pulled(points: FramePoints, hard: torch.Tensor) -> None:
    """A step in which all points show, those of ``hard`` (N,) bool with ten times the gradient."""
    gradient = torch.full_like(points.xyz, 0.1)
    gradient[hard] *= 10
    accumulate_gradient_magnitudes(points, torch.arange(len(hard)), gradient)


def test_new_points_lie_among_those_that_pull_hardest() -> None:
    """Catches points added anywhere, off the surface, or with what their parents are not."""
    points = sheet()
    hard = points.xyz[:, 0] > 0.175
    pulled(points, hard)
    done = densify(points, CONFIG, unobserved_points(points, 40), [0])
    assert 30 <= done.added <= 40
    assert done.removed == 0
    new = points.xyz[400:]
    assert len(torch.unique(new, dim=0)) == len(new) == done.added
    assert (new[:, 0] > 0.16).all()
    assert (new[:, 2] == 0).all()
    torch.testing.assert_close(points.parameters["rgb"][400:], new / 0.19)
    assert (points.spacing[400:] < 0.0081).all()
    assert (points.spacing[400:] > 0.003).all()
    assert {name: len(value) for name, value in points.parameters.items()} == {
        "xyz": len(points.xyz),
        "rgb": len(points.xyz),
    }
    assert points.optimizer.moments["xyz"].shape == (2, len(points.xyz), 3)
    assert float(points.optimizer.moments["xyz"][:, 400:].abs().max()) == 0


def test_the_count_is_bounded() -> None:
    """Catches a cloud that grows with every round."""
    points = sheet(colours=False)
    for number in range(12):
        pulled(points, torch.ones(len(points.xyz), dtype=torch.bool))
        densify(points, CONFIG, unobserved_points(points, 40), [number])
    assert 0.97 * 500 <= len(points.xyz) <= 500


def test_what_never_shows_goes_and_what_stands_for_the_unseen_stays() -> None:
    """Catches pruning before a point could show, of points that came late, and of those that no camera can see."""
    points = sheet(colours=False)
    shows = points.xyz[:, 1] > 0.095
    points.is_permanent[:7] = True
    for _ in range(5):
        accumulate_gradient_magnitudes(points, torch.nonzero(shows)[:, 0], torch.full((int(shows.sum()), 3), 0.1))
    assert densify(points, replace(CONFIG, share=0.0), unobserved_points(points, 6), [0]).removed == 0
    assert densify(points, CONFIG, unobserved_points(points, 5), [0]).removed == 193
    kept = len(points.xyz)
    assert densify(points, replace(CONFIG, share=0.0), unobserved_points(points, 1), [1]).removed == 0, (
        "new points had no step to show in"
    )
    assert kept > 207


def test_rounds_are_the_same_for_the_same_seed(rng: np.random.Generator) -> None:
    """Catches partners drawn from a state that a resumed run does not have."""
    hard = torch.from_numpy(rng.random(400) < 0.2)
    found = []
    for _ in range(2):
        points = sheet()
        pulled(points, hard)
        densify(points, CONFIG, unobserved_points(points, 40), [1, 2, 3])
        found.append(points.xyz)
    assert torch.equal(*found)


def test_history_survives_a_file(tmp_path: Path) -> None:
    """Catches a resumed run that has forgotten which points showed, and files of before points had a history."""
    points = sheet()
    pulled(points, points.xyz[:, 0] > 0.1)
    named = points.tensors()
    again = FramePoints.from_tensors(named)
    assert torch.equal(again.gradient_sum, points.gradient_sum)
    assert int(again.age) == 1
    old = {name: value for name, value in named.items() if name not in ("error", "shown", "born", "age", "first")}
    assert int(FramePoints.from_tensors(old).initial_count) == 400


def test_outside_all_images_is_what_no_picture_holds() -> None:
    """Catches a shell that is pruned since no step shows it."""
    cameras = ring_cameras(4, 64)
    xyz = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 50.0], [0.0, 0.0, -50.0]])
    assert outside_all_images(xyz, cameras).tolist() == [False, True, True]


def test_a_run_grows_and_its_points_are_saved(ball_capture: Path, tmp_path: Path) -> None:
    """Catches rounds that never come, or whose points a checkpoint loses."""
    config = full_config(tmp_path / "shell.ply")
    config = replace(config, max_steps=24, densify=DensifyConfig(frame_every=2, background_every=6, until=1.0))
    run = trained_run(ball_capture, tmp_path / "run", config)
    newest = sorted(run.checkpoints.glob("*.safetensors"))[-1]
    static = load_file(points_folder(newest) / "background.safetensors")
    assert 1200 < len(static["free.xyz"]) <= 1500
    counts = [len(load_file(path)["free.xyz"]) for path in sorted(points_folder(newest).glob("0*.safetensors"))]
    assert max(counts) > min(counts)
