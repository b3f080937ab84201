"""Camera refinement: gradients, identity corrections, convergence, and the written calibration files."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.pipeline.make import create_run
from fourd.reconstruction.training.cameras.calibration import with_start_cameras, write_corrected, zoomed_distortion
from fourd.reconstruction.training.cameras.refinement import Refinement
from fourd.reconstruction.training.cameras.rig import Rig
from fourd.reconstruction.training.config import RefineConfig, TrainConfig
from fourd.reconstruction.training.evaluation.camera_fitting import fit_test_camera
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.rendering import RenderablePoints
from fourd.reconstruction.training.run import load_run, open_run
from fourd.reconstruction.training.step import StepResult
from fourd.recording.calibration.perturbation import perturb_cameras, pose_errors
from fourd.recording.capture import open_capture, read_calibration, write_calibration
from fourd.rendering import render_points
from fourd.scene.bake import make_manifest
from tests.captures import ring_cameras
from tests.training.small import SMALL, full_config, quiet, train, trained_run, with_steps
from tests.training.test_loop import checkpoint_tensors

EVERYTHING = RefineConfig(poses=True, focal=True, colours=True)
OFF = RefineConfig()


def _cloud(rng: np.random.Generator, camera: Camera, count: int = 60) -> RenderablePoints:
    """Points in front of ``camera`` at very different depths, so that small changes of the camera do not change their
    depth order."""
    depths = 1.6 + 0.8 * rng.permutation(count)[:, None] / count
    in_camera = np.hstack([rng.uniform(-0.4, 0.4, (count, 2)), depths])
    xyz = torch.from_numpy((in_camera - camera.translation) @ camera.rotation)
    radius = torch.full((count,), 0.12, dtype=torch.float64)
    density = torch.full((count,), 0.6, dtype=torch.float64)
    colour = torch.from_numpy(rng.uniform(0, 1, (count, 3)))
    return RenderablePoints(xyz, radius, density, colour)


def _render(part: RenderablePoints, camera: Camera) -> Tensor:
    shown = render_points(part.xyz, part.colour, part.radius, part.density, camera, layers=64, backend="reference")
    return shown.features


def _set(refinement: Refinement, place: int, pose: NDArray[np.float64], zoom: float) -> None:
    with torch.no_grad():
        refinement.poses[place].copy_(torch.from_numpy(pose))
        refinement.zooms[place].fill_(zoom)


def test_camera_gradients_equal_finite_differences(rng: np.random.Generator) -> None:
    """Catches a wrong sign, coordinate frame or Jacobian in the gradient of a pose, and a zoom that does not change
    radii in pixels."""
    cameras = ring_cameras(3, 24)
    refinement = Refinement(EVERYTHING, cameras, [0, 1, 2], np.zeros(3)).double()
    pose, zoom = rng.normal(0, 0.1, 6), 0.05
    _set(refinement, 1, pose, zoom)
    part = _cloud(rng, refinement.rig().cameras[1])
    weight = torch.from_numpy(rng.normal(size=(24, 24, 3)))

    def loss(pose: NDArray[np.float64], zoom: float) -> float:
        _set(refinement, 1, pose, zoom)
        return float((_render(part, refinement.rig().cameras[1]) * weight).sum())

    step = 1e-8
    expected = []
    for axis in range(7):
        change = np.eye(7)[axis] * step
        ahead, behind = (loss(pose + sign * change[:6], zoom + sign * change[6]) for sign in (1, -1))
        expected.append((ahead - behind) / (2 * step))
    _set(refinement, 1, pose, zoom)
    (_render(refinement.attach_camera_gradient([part], 1)[0], refinement.rig().cameras[1]) * weight).sum().backward()
    poses, zooms = refinement.poses[1].grad, refinement.zooms[1].grad
    assert poses is not None
    assert zooms is not None
    got = [*poses.tolist(), *zooms.tolist()]
    assert got == pytest.approx(expected, rel=2e-3, abs=2e-3 * max(map(abs, expected)))
    assert refinement.poses[0].grad is None


def test_zero_corrections_are_exactly_the_identity(rng: np.random.Generator) -> None:
    """Catches identity corrections that change cameras, points, radii or colours by as little as one bit."""
    cameras = ring_cameras(4, 24)
    refinement = Refinement(EVERYTHING, cameras, [0, 1, 3], np.zeros(3))
    rig = refinement.rig()
    for camera, given in zip(rig.cameras, cameras, strict=True):
        for name in ("intrinsics", "rotation", "translation"):
            assert np.array_equal(getattr(camera, name), getattr(given, name))
    with torch.no_grad():
        for parameter in (*refinement.poses, *refinement.zooms):
            parameter.copy_(torch.from_numpy(rng.normal(0, 0.3, parameter.shape)))
    part = _cloud(rng, cameras[3])
    part = replace(part, xyz=part.xyz.float(), radius=part.radius.float())
    seen = refinement.attach_camera_gradient([part], 3)[0]
    assert torch.equal(seen.xyz, part.xyz)
    assert torch.equal(seen.radius, part.radius)
    colour, alpha = torch.rand(4, 5, 3), torch.rand(4, 5)
    assert torch.equal(refinement.recolour(colour, alpha, 1), colour)
    picture = torch.rand(3, 4, 5)
    assert torch.equal(rig.scene_colours(1, picture), picture)


def test_colour_corrections_have_mean_identity_and_are_inverted_in_sources(rng: np.random.Generator) -> None:
    """Catches a mean of all cameras' colour corrections that differs from the identity, which would change the colours
    of the scene. Also catches source views that are corrected by the forward map instead of the inverse map."""
    refinement = Refinement(EVERYTHING, ring_cameras(4, 24), [0, 2, 3], np.zeros(3))
    with torch.no_grad():
        for tint in refinement.tints:
            tint.copy_(torch.from_numpy(rng.normal(0, 0.1, (3, 4))))
    rig = refinement.rig()
    assert rig.colours is not None
    torch.testing.assert_close(rig.colours[[0, 2, 3]].mean(0), torch.eye(3, 4), atol=1e-6, rtol=0)
    assert torch.equal(rig.colours[1], torch.eye(3, 4))
    rgb = torch.rand(5, 6, 3)
    seen = rig.camera_colours(2, rgb, torch.ones(5, 6))
    torch.testing.assert_close(seen, refinement.recolour(rgb, torch.ones(5, 6), 2))
    torch.testing.assert_close(rig.scene_colours(2, seen.permute(2, 0, 1)).permute(1, 2, 0), rgb, atol=1e-5, rtol=0)


@pytest.mark.parametrize("scene", ["object", "full"])
def test_a_resumed_refined_run_equals_an_uninterrupted_one(
    scene: str, ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches corrections or optimizer state that are missing in checkpoints, and cameras that are not updated."""
    config = SMALL if scene == "object" else full_config(tmp_path / "shell.ply")
    config = replace(config, max_steps=9, refine=EVERYTHING)
    uninterrupted = create_run(ball_capture, tmp_path / "whole", config)
    train(uninterrupted, config)
    interrupted = create_run(ball_capture, tmp_path / "broken", config)
    trainer = Trainer(interrupted, None, quiet(), config)
    original_step = trainer.stepper.step

    def step_until_five(*arguments: Any) -> StepResult:
        if arguments[-1] == 5:
            raise InterruptedError
        return original_step(*arguments)

    monkeypatch.setattr(trainer.stepper, "step", step_until_five)
    with pytest.raises(InterruptedError):
        trainer.train()
    train(open_run(tmp_path / "broken"), config)
    expected, got = checkpoint_tensors(tmp_path / "whole", 9), checkpoint_tensors(tmp_path / "broken", 9)
    assert any(name.startswith("refinement.poses") and value.any() for name, value in expected.items())
    assert expected.keys() == got.keys()
    assert not [name for name in expected if not torch.equal(expected[name], got[name])]


def test_a_loaded_run_uses_its_corrected_cameras(ball_capture: Path, tmp_path: Path) -> None:
    """Catches rendering or export with uncorrected cameras, and calibration files that differ from the corrected
    cameras."""
    run = trained_run(ball_capture, tmp_path / "run", replace(SMALL, refine=EVERYTHING))
    trained = load_run(run.folder)
    cameras = trained.run.capture.cameras
    moved = [
        not np.array_equal(now.rotation, was.rotation) for now, was in zip(cameras, run.capture.cameras, strict=True)
    ]
    assert moved.count(True) >= 4
    assert not moved[3]
    assert trained.renderer.views.rig.cameras == cameras
    assert trained.renderer.views.view(0, 1).camera.rotation.tolist() == cameras[0].rotation.tolist()
    assert make_manifest(trained).source_cameras == tuple(cameras[index] for index in run.training)
    written = read_calibration(run.folder / "calibration")
    for name, camera in zip(run.capture.names, cameras, strict=True):
        assert written[name].rotation.tolist() == camera.rotation.tolist()
        assert np.allclose(written[name].intrinsics, camera.intrinsics, rtol=1e-14)
    colours = json.loads((run.folder / "calibration" / "colours.json").read_text())
    assert colours["03"]["matrix"] == np.eye(3).tolist()
    assert trained.renderer.views.rig.colours is not None
    assert np.allclose(colours["05"]["matrix"], trained.renderer.views.rig.colours[5, :, :3])


def test_a_written_calibration_gives_the_same_cameras(ball_capture: Path, tmp_path: Path) -> None:
    """Catches focal lengths that are written at the wrong image scale, and calibration files without the cameras that
    are not selected."""
    half = open_capture(ball_capture, views=["01", "02", "05"], scale=0.5)
    moved = list(
        perturb_cameras(dict(zip(half.names, half.cameras, strict=True)), 2, 0.1, np.random.default_rng(0)).values()
    )
    zoom = np.diag([1.1, 1.1, 1.0])
    k = zoom @ moved[0].intrinsics
    k[:2, 2] = moved[0].intrinsics[:2, 2]
    moved[0] = replace(moved[0], intrinsics=k)
    write_corrected(tmp_path, half, Rig(tuple(moved)), "start")
    again = with_start_cameras(half, tmp_path)
    for camera, other in zip(moved, again.cameras, strict=True):
        for name in ("intrinsics", "rotation", "translation"):
            assert np.allclose(getattr(camera, name), getattr(other, name), rtol=0, atol=1e-12)
    assert list(read_calibration(tmp_path / "calibration" / "start")) == [f"{index:02d}" for index in range(8)]
    with pytest.raises(UserError, match=r"start: expected the start cameras of the run, got no file; train in"):
        with_start_cameras(half, tmp_path / "nowhere")


@pytest.mark.parametrize("count", [4, 5, 8, 12])
def test_distortion_scales_with_the_focal_length(count: int, rng: np.random.Generator) -> None:
    """Catches a written calibration whose undistorted images differ from the training images."""
    distortion = rng.normal(0, 0.02, count)
    k = np.array([[400.0, 0, 320], [0, 420, 240], [0, 0, 1]])
    zoomed = np.diag([1.05, 1.05, 1.0]) @ k
    zoomed[:2, 2] = k[:2, 2]
    pixels = rng.uniform((0, 0), (640, 480), (50, 2))

    def in_file(lens: NDArray[np.float64], coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        rays = np.column_stack([pixels, np.ones(50)]) @ np.linalg.inv(lens).T
        return np.asarray(cv2.projectPoints(rays, np.zeros(3), np.zeros(3), lens, coefficients)[0][:, 0])

    assert np.allclose(in_file(k, distortion), in_file(zoomed, zoomed_distortion(distortion, 1.05)), atol=1e-8)


def test_a_held_out_camera_is_aligned(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a fit of a held-out camera that diverges, changes the scene, or reports a wrong distance."""
    config = replace(with_steps(SMALL, 60), checkpoint_steps=1000)
    run = trained_run(ball_capture, tmp_path / "run", config)
    trained = load_run(run.folder)
    index = run.test[0]
    views = trained.renderer.views
    given = dict(zip(run.capture.names, run.capture.cameras, strict=True))
    cameras = list(perturb_cameras(given, 4, 0.02, np.random.default_rng(1)).values())
    wrong = tuple(camera if at == index else run.capture.cameras[at] for at, camera in enumerate(cameras))
    views.rig = Rig(wrong)
    before = trained.frames.get(0).xyz.clone()
    fitted = fit_test_camera(trained.renderer, trained.frames, index, 8, colours=True)
    assert torch.equal(before, trained.frames.get(0).xyz)
    true_camera = run.capture.cameras[index]
    xyz = before.numpy()
    expected = true_camera.project(xyz)[0]
    error = [np.abs(camera.project(xyz)[0] - expected).mean() for camera in (cameras[index], fitted.camera)]
    assert error[1] < 0.3 * error[0]
    assert fitted.distance == pytest.approx(float(np.linalg.norm(fitted.camera.centre - cameras[index].centre)))
    assert fitted.colours is not None
    assert np.abs(fitted.colours - np.eye(3, 4)).max() < 0.5


def test_refinement_is_off_by_default() -> None:
    """Catches a default config that changes the cameras, or that corrects colours without a measurement."""
    assert [OFF.cameras, OFF.colours] == [False, None]
    assert TrainConfig().refine == OFF
    with pytest.raises(ValueError, match="rotation_deg: expected more than 0, got 0"):
        RefineConfig(rotation_deg=0)
    assert pose_errors({"a": ring_cameras(1, 8)[0]}, {"a": ring_cameras(1, 8)[0]})["a"].degrees < 1e-6


def _copied(capture: Path, folder: Path) -> Path:
    shutil.copytree(capture, folder, ignore=shutil.ignore_patterns(".fourd"))
    return folder


def test_learnt_poses_approach_the_truth(ball_capture: Path, tmp_path: Path) -> None:
    """Catches pose gradients that reach the wrong camera, and training steps that render with uncorrected cameras."""
    opened = open_capture(ball_capture)
    truth = dict(zip(opened.names, opened.cameras, strict=True))
    wrong = perturb_cameras(truth, 1.0, 0.0, np.random.default_rng(0))
    capture = _copied(ball_capture, tmp_path / "capture")
    write_calibration(capture, list(wrong), list(wrong.values()))
    refine = RefineConfig(poses=True, pose_rate=2e-3)
    config = replace(SMALL, test_views=(), frames="0:2", max_steps=100, checkpoint_steps=1000, refine=refine)
    run = trained_run(capture, tmp_path / "run", config)

    def error(cameras: tuple[Camera, ...]) -> float:
        errors = pose_errors(truth, dict(zip(opened.names, cameras, strict=True)))
        return float(np.mean([each.degrees for each in errors.values()]))

    assert error(load_run(run.folder).run.capture.cameras) < 0.9 * error(run.capture.cameras)


def test_a_darker_camera_is_detected(ball_capture: Path, tmp_path: Path) -> None:
    """Catches colour corrections that are inverted or belong to the wrong camera."""
    capture = _copied(ball_capture, tmp_path / "capture")
    for path in (capture / "images" / "02").iterdir():
        picture = cv2.imread(str(path))
        assert picture is not None
        assert cv2.imwrite(str(path), (picture * 0.7).astype(np.uint8))
    refine = RefineConfig(colours=True, colour_rate=2e-2)
    config = replace(SMALL, max_steps=60, checkpoint_steps=1000, refine=refine)
    trained = load_run(trained_run(capture, tmp_path / "run", config).folder)
    colours = trained.renderer.views.rig.colours
    assert colours is not None
    brightness = (colours @ torch.tensor([0.5, 0.5, 0.5, 1.0])).mean(dim=1)
    assert int(brightness.argmin()) == 2
    assert trained.run.capture.cameras[2].rotation.tolist() == open_capture(capture).cameras[2].rotation.tolist()


def test_a_run_without_start_cameras_is_refused(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a run that is resumed or exported with the capture's cameras instead of its own start cameras."""
    run = create_run(ball_capture, tmp_path / "run", replace(SMALL, refine=EVERYTHING))
    shutil.rmtree(run.folder / "calibration")
    with pytest.raises(UserError, match=r"calibration/start: expected the start cameras of the run, got no file"):
        open_run(run.folder)


def test_a_tilted_sensor_is_refused_where_focal_lengths_are_refined(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a written calibration that differs from the cameras used in training."""
    capture = _copied(ball_capture, tmp_path / "capture")
    opened = open_capture(capture)
    tilted = np.zeros(14)
    tilted[12] = 0.01
    cameras = [replace(camera, distortion=tilted) for camera in opened.cameras]
    write_calibration(capture, opened.names, cameras)
    with pytest.raises(UserError, match=r"intri.yml: D_00: expected a sensor without tilt .* set refine.focal: false"):
        create_run(capture, tmp_path / "run", replace(SMALL, refine=RefineConfig(focal=True)))
