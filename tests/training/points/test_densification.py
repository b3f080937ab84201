"""Densification: points with large gradients are split, and unobserved points are removed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file

from fourd.reconstruction.training.background import outside_all_images
from fourd.reconstruction.training.config import DensifyConfig
from fourd.reconstruction.training.points.densification import (
    accumulate_gradient_magnitudes,
    densify,
    unobserved_points,
)
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.run_layout import points_folder
from tests.captures import ring_cameras
from tests.training.small import full_config, trained_run

CONFIG = DensifyConfig(share=0.1, growth=1.25)


def sheet(side: int = 20, *, colours: bool = True) -> FramePoints:
    """A grid of side * side points in the plane z = 0, with a spacing of one centimetre. The red colour is proportional
    to x."""
    x, y = torch.meshgrid(torch.arange(side) * 0.01, torch.arange(side) * 0.01, indexing="ij")
    xyz = torch.stack([x, y, torch.zeros_like(x)], -1).reshape(-1, 3).float()
    rgb = xyz / xyz.max() if colours else None
    return FramePoints.initial(xyz, torch.full((side * side,), 0.01), 1.3, explicit_sh=False, rgb=rgb)


def observe(points: FramePoints, large: torch.Tensor) -> None:
    """Simulate a training step in which all points have gradients. The gradients of the points in ``large`` (N,) bool
    are ten times as large."""
    gradient = torch.full_like(points.xyz, 0.1)
    gradient[large] *= 10
    accumulate_gradient_magnitudes(points, torch.arange(len(large)), gradient)


def test_new_points_lie_among_those_with_the_largest_gradients() -> None:
    """Catches new points at a wrong position or off the surface, and new points whose attributes do not match the
    attributes of their parents."""
    points = sheet()
    large = points.xyz[:, 0] > 0.175
    observe(points, large)
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


def test_the_number_of_points_is_bounded() -> None:
    """Catches a number of points that grows without limit with every densification."""
    points = sheet(colours=False)
    for number in range(12):
        observe(points, torch.ones(len(points.xyz), dtype=torch.bool))
        densify(points, CONFIG, unobserved_points(points, 40), [number])
    assert 0.97 * 500 <= len(points.xyz) <= 500


def test_unobserved_points_are_removed_and_permanent_ones_kept() -> None:
    """Catches the removal of new points that no step has observed yet, and of points outside all images."""
    points = sheet(colours=False)
    visible = points.xyz[:, 1] > 0.095
    points.is_permanent[:7] = True
    for _ in range(5):
        accumulate_gradient_magnitudes(points, torch.nonzero(visible)[:, 0], torch.full((int(visible.sum()), 3), 0.1))
    assert densify(points, replace(CONFIG, share=0.0), unobserved_points(points, 6), [0]).removed == 0
    assert densify(points, CONFIG, unobserved_points(points, 5), [0]).removed == 193
    kept = len(points.xyz)
    assert densify(points, replace(CONFIG, share=0.0), unobserved_points(points, 1), [1]).removed == 0, (
        "no step could observe the new points"
    )
    assert kept > 207


def test_densification_is_reproducible(rng: np.random.Generator) -> None:
    """Catches new points that depend on a random generator whose state is lost when a run is resumed."""
    large = torch.from_numpy(rng.random(400) < 0.2)
    found = []
    for _ in range(2):
        points = sheet()
        observe(points, large)
        densify(points, CONFIG, unobserved_points(points, 40), [1, 2, 3])
        found.append(points.xyz)
    assert torch.equal(*found)


def test_the_gradient_history_is_saved(tmp_path: Path) -> None:
    """Catches a gradient history that is lost when a run is resumed, and an error for older files without a gradient
    history."""
    points = sheet()
    observe(points, points.xyz[:, 0] > 0.1)
    named = points.tensors()
    again = FramePoints.from_tensors(named)
    assert torch.equal(again.gradient_sum, points.gradient_sum)
    assert int(again.age) == 1
    old = {name: value for name, value in named.items() if name not in ("error", "shown", "born", "age", "first")}
    assert int(FramePoints.from_tensors(old).initial_count) == 400


def test_points_outside_all_images_are_found() -> None:
    """Catches the removal of background points that are outside all images, for example the points of the shell."""
    cameras = ring_cameras(4, 64)
    xyz = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 50.0], [0.0, 0.0, -50.0]])
    assert outside_all_images(xyz, cameras).tolist() == [False, True, True]


def test_a_run_densifies_and_saves_its_points(ball_capture: Path, tmp_path: Path) -> None:
    """Catches training without densification, and new points that are missing in checkpoints."""
    config = full_config(tmp_path / "shell.ply")
    config = replace(config, max_steps=24, densify=DensifyConfig(frame_every=2, background_every=6, until=1.0))
    run = trained_run(ball_capture, tmp_path / "run", config)
    newest = sorted(run.checkpoints.glob("*.safetensors"))[-1]
    static = load_file(points_folder(newest) / "background.safetensors")
    assert 1200 < len(static["free.xyz"]) <= 1500
    counts = [len(load_file(path)["free.xyz"]) for path in sorted(points_folder(newest).glob("0*.safetensors"))]
    assert max(counts) > min(counts)
