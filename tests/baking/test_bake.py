"""Export of a run to a scene, which must give the same images as the run, without torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.reconstruction.model.appearance import MIN_VISIBILITY
from fourd.reconstruction.model.sources import OCCLUSION_FALLOFF_SPACINGS
from fourd.reconstruction.training.run import TrainedRun, load_run
from fourd.scene import open_scene
from fourd.scene.bake import bake_run
from tests.training.small import SMALL, full_config, quiet, trained_run, with_steps

BALL_RADIUS = 0.4


@pytest.fixture(scope="module", params=["object", "full", "shadow"])
def trained(request: pytest.FixtureRequest, ball_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> TrainedRun:
    folder = tmp_path_factory.mktemp("runs")
    config = SMALL if request.param == "object" else full_config(folder / "shell.ply", shadow=request.param == "shadow")
    made = load_run(trained_run(ball_capture, folder / "run", with_steps(config, 12)).folder)
    if request.param == "shadow":
        _darken(made)
    return made


def _darken(trained: TrainedRun) -> None:
    """Extend the bounds of the shadow model to the background points, and make shadows differ between frames."""
    background = trained.renderer.background
    assert background is not None
    shadow = background.model.shadow
    assert shadow is not None
    shadow.lower -= 8
    shadow.upper += 8
    with torch.no_grad():
        for plane in shadow.planes.parameters():
            plane += torch.randn(plane.shape, generator=torch.Generator().manual_seed(1))


@pytest.fixture(scope="module")
def scene_path(trained: TrainedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenes") / "scene.4dv"
    bake_run(trained, path, quiet(), layers=SMALL.layers)
    return path


def test_the_scene_renders_like_the_run(trained: TrainedRun, scene_path: Path) -> None:
    """Catches differences between baking and rendering in blend weights, colours or radii."""
    scene = open_scene(scene_path)
    for frame in range(3):
        for camera in (trained.run.capture.cameras[3], trained.run.capture.cameras[6]):
            live = trained.renderer.render(trained.frames.get(frame), frame, camera, SMALL.layers).rgb
            baked = scene.render(camera, frame).rgb.clip(0, 1)
            error = float(np.square(live - baked).mean())
            assert -10 * np.log10(error) > 50


def test_occluded_views_have_weight_zero(trained: TrainedRun, scene_path: Path) -> None:
    """Catches small blend weights that mix the colours of the ball's front into the ball's back."""
    scene = open_scene(scene_path)
    count = scene.manifest.points[1]
    xyz, weights = scene.frame(1).xyz[:count], scene.frame(1).blend_weights[:count]
    outwards = xyz - xyz.mean(axis=0)
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    centres = np.stack([camera.centre for camera in scene.manifest.source_cameras])
    towards = centres[None] - xyz[:, None]
    facing = np.einsum("nc,nvc->nv", outwards, towards) / np.linalg.norm(towards, axis=2)
    behind = -2 * BALL_RADIUS * facing  # depth behind the front of the ball
    hidden = behind > (2 - np.log(MIN_VISIBILITY)) * OCCLUSION_FALLOFF_SPACINGS * trained.model.spacing + 0.05
    assert hidden.sum() > 100
    assert (weights[hidden] == 0).mean() > 0.98
    assert (weights[facing > 0.7] > 0).mean() > 0.98
    assert set(weights.max(axis=1).tolist()) <= {0.0, 1024.0}


def test_a_scene_has_shadows_if_its_run_has(trained: TrainedRun, scene_path: Path) -> None:
    """Catches shadows that are missing, equal in all frames or baked into the background's colours."""
    scene = open_scene(scene_path)
    background = trained.renderer.background
    has = background is not None and background.model.shadow is not None
    described = scene.manifest.background
    assert (described is not None and described.shadow) == has
    if has:
        colours = [scene.frame(frame).rgb[scene.manifest.points[frame] :].astype(int) for frame in range(2)]
        assert np.abs(colours[0] - colours[1]).mean() > 2


def test_held_out_cameras_are_not_source_views(trained: TrainedRun, scene_path: Path) -> None:
    """Catches a held-out camera among the source views."""
    manifest = open_scene(scene_path).manifest
    assert "03" not in manifest.source_names
    assert manifest.other_names == ("03",)
