"""Object scenes and full scenes: their target images, models and learning rates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from fourd.pipeline.make import create_run
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.scenes.build import build_scene
from fourd.reconstruction.training.scenes.full_scene import FullScene, place_window
from fourd.reconstruction.training.scenes.object_scene import ObjectScene
from fourd.reconstruction.training.schedule import StepSample
from tests.captures import ring_cameras
from tests.training.small import SMALL, full_config

SAMPLE = StepSample(0, 0, [1, 2, 4, 5], np.ones(4, np.float32), np.zeros(3, np.float32), 8, position=(0.9, 0.2, 0.7))
PLATE = replace(SAMPLE, is_plate=True)


def full_scene(capture: Path, folder: Path, config: TrainConfig) -> FullScene:
    run = create_run(capture, folder / "run", config)
    scene = build_scene(config, run.new_model(), run.view_store(), run.background(None), 0.01)
    assert isinstance(scene, FullScene)
    return scene


def test_windows_cover_the_picture() -> None:
    """Catches crop windows that extend beyond the image, and image corners that no window contains."""
    camera = ring_cameras(4, 64)[0]
    positions = [(x, y) for x in (0.0, 0.5, 0.999) for y in (0.0, 0.5, 0.999)]
    windows = [place_window(camera, 32, position) for position in positions]
    assert {window[2:] for window in windows} == {(32, 32)}
    assert {window[:2] for window in windows} == {(x, y) for x in (0, 16, 32) for y in (0, 16, 32)}
    assert place_window(camera, 500, (0.3, 0.9)) == (0, 0, 64, 64)


def test_an_object_is_its_matte_on_black(ball_capture: Path, tmp_path: Path) -> None:
    """Catches an object scene whose target or reference image shows pixels outside the object."""
    run = create_run(ball_capture, tmp_path / "run", SMALL)
    scene = build_scene(SMALL, run.new_model(), run.view_store(), None, 0.01)
    assert isinstance(scene, ObjectScene)
    target = scene.target(SAMPLE)
    assert target.matte is not None
    assert not target.rgb[target.matte == 0].any()
    assert torch.equal(target.known, target.matte)
    reference = scene.reference_picture(scene.views.view(0, 0))
    np.testing.assert_array_equal(reference, target.rgb.numpy())


def test_a_full_scene_renders_frames_and_plates(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a matte for plates, which have no foreground, and a step on a plate that renders the foreground."""
    scene = full_scene(ball_capture, tmp_path, full_config(tmp_path / "shell.ply"))
    assert list(scene.models) == ["model", "background"]
    points = scene.background.points
    prepared = scene.prepare(points, PLATE)
    frame, plate = scene.prepare(points, SAMPLE).target, prepared.target
    assert frame.matte is not None
    assert frame.known.all()
    assert plate.matte is None
    assert plate.rgb.shape == (32, 32, 3)
    clouds = scene.evaluate_step(points, 0.0, PLATE, prepared, 0)
    assert [each.cloud is points for each in clouds] == [True]


def test_without_joint_training_frames_are_objects(ball_capture: Path, tmp_path: Path) -> None:
    """Catches target images that still contain the background when the foreground is trained alone."""
    config = full_config(tmp_path / "shell.ply")
    config = replace(config, background=replace(config.background, joint=False))
    scene = full_scene(ball_capture, tmp_path, config)
    frame, plate = (scene.prepare(scene.background.points, each).target for each in (SAMPLE, PLATE))
    assert torch.equal(frame.rgb, scene.foreground.target(SAMPLE).rgb)
    assert not frame.fills_picture
    assert plate.fills_picture


def test_rates_of_positions_scale_with_the_spacing(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a learning rate that depends on the extent of the scene instead of on the distance between points. Also
    catches background points that are trained with the learning rate of the foreground."""
    config = full_config(tmp_path / "shell.ply")
    scene = full_scene(ball_capture, tmp_path, config)
    plate = scene.prepare(scene.background.points, PLATE)
    background = scene.evaluate_step(scene.background.points, 0.0, PLATE, plate, 0)[0]
    rate = scene.xyz_rate(background, 0.5)
    assert isinstance(rate, torch.Tensor)
    expected = 0.5 * config.background.xyz_rate * background.cloud.spacing[background.rows]
    torch.testing.assert_close(rate[:, 0], expected)
    ratio = config.rates.xyz_spacings / config.background.xyz_rate
    foreground = replace(background, cloud=replace(background.cloud))
    torch.testing.assert_close(scene.xyz_rate(foreground, 0.5), expected[:, None] * ratio)


def test_rates_of_positions_fall_with_the_updates_of_each_point(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a learning rate that decreases with the steps of the run instead of with the updates of each point."""
    config = full_config(tmp_path / "shell.ply")
    config = replace(config, rates=replace(config.rates, xyz_spacings=0.5, xyz_halving_updates=20))
    scene = full_scene(ball_capture, tmp_path, config)
    plate = scene.prepare(scene.background.points, PLATE)
    background = scene.evaluate_step(scene.background.points, 0.0, PLATE, plate, 0)[0]
    foreground = replace(background, cloud=replace(background.cloud))
    foreground.cloud.optimizer.steps[foreground.rows[0]] = 20
    foreground.cloud.optimizer.steps[foreground.rows[1]] = 60
    spacing = foreground.cloud.spacing[foreground.rows[:3]]
    expected = 0.5 * spacing / torch.tensor([2.0, 4.0, 1.0])
    torch.testing.assert_close(scene.xyz_rate(foreground, 1.0)[:3, 0], expected)
