"""Full scenes: compositing with the background, visibility in plates, and initial background points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest
import torch

from fourd.base.cameras import look_at
from fourd.base.errors import UserError
from fourd.pipeline.make import create_run
from fourd.reconstruction.model.appearance import blend, mix_own_colours
from fourd.reconstruction.training.background import CACHED_STEPS, outside_all_images
from fourd.reconstruction.training.occlusion import occlusion_depth, surface_depth
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.rendering import RenderablePoints, composite, visible_points
from fourd.reconstruction.training.run import Run, load_run
from tests.captures import ring_cameras
from tests.training.small import full_config, trained_run

EMPTY_PLY = """ply
format ascii 1.0
element vertex 0
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""


@pytest.fixture(scope="module")
def run(ball_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("full")
    return trained_run(ball_capture, folder / "run", replace(full_config(folder / "shell.ply"), max_steps=30))


def _sheet(distance: float, side: float) -> FramePoints:
    """A dense square sheet of points perpendicular to the x axis. The first camera of a ring sees the sheet."""
    steps = torch.linspace(-side, side, 41)
    y, z = torch.meshgrid(steps, steps, indexing="ij")
    xyz = torch.stack([torch.full_like(y, distance), y, z], -1).reshape(-1, 3)
    count = len(xyz)
    spacing = torch.full((count,), 2 * side / 40)
    return FramePoints.initial(xyz, spacing, 1.5, explicit_sh=False)


def _painted(points: FramePoints, colour: tuple[float, float, float]) -> RenderablePoints:
    colours = torch.tensor(colour).expand(len(points.xyz), 3)
    return RenderablePoints(points.xyz, points.radius, points.density, colours)


def test_clouds_occlude_each_other_in_any_order() -> None:
    """Catches foreground and background clouds that are composited one after the other. Background points in front of
    the foreground must occlude the foreground."""
    viewer = ring_cameras(8, 64)[0]
    near = _painted(_sheet(0.5, 0.2), (1.0, 0.0, 0.0))
    far = _painted(_sheet(-1.0, 3.0), (0.0, 0.0, 1.0))
    for clouds, coverage in (([near, far], 1.0), ([far, near], 0.0)):
        picture = composite(clouds, viewer, 15, 0.01).features
        assert picture[32, 32, :3].tolist() == pytest.approx([1, 0, 0], abs=0.05)
        assert picture[4, 4, :3].tolist() == pytest.approx([0, 0, 1], abs=0.05)
        assert float(picture[32, 32, 3]) == pytest.approx(coverage, abs=0.05)
        assert float(picture[4, 4, 3]) == pytest.approx(1 - coverage, abs=0.05)


def test_points_occluded_by_the_other_cloud_are_not_visible() -> None:
    """Catches visibility that is computed for each point cloud separately. Points that the other cloud occludes would
    then be trained."""
    viewer = ring_cameras(8, 64)[0]
    near, far = _sheet(0.5, 1.2), _sheet(-1.0, 0.3)
    assert len(visible_points([far], viewer, 15, 0.01, 0.05)[0]) > 0
    both = visible_points([near, far], viewer, 15, 0.01, 0.05)
    assert [len(rows) > 0 for rows in both] == [True, False]


def test_a_point_s_own_colour_replaces_views_that_do_not_see_it() -> None:
    """Catches black or unrelated colours of points that none of the blended plates shows."""
    colours = torch.tensor([[[0.0, 0.0, 0.0]], [[0.9, 0.1, 0.1]]])
    base = torch.tensor([[0.2, 0.5, 0.4]])
    visibility = torch.zeros(2, 1)
    unseen = blend(torch.zeros(2, 1), visibility, mix_own_colours(colours, visibility, base, 0.0))
    torch.testing.assert_close(unseen, base)
    visibility = torch.tensor([[0.0], [1.0]])
    half_seen = blend(torch.zeros(2, 1), visibility, mix_own_colours(colours, visibility, base, 0.0))
    assert torch.equal(half_seen, colours[1])


def test_a_full_run_renders_the_surroundings_of_the_subject(run: Run) -> None:
    """Catches a background that is missing in rendered images, in the loss or in the checkpoint."""
    trained = load_run(run.folder)
    camera = run.capture.cameras[run.test[0]]
    picture = trained.renderer.render(trained.frames.get(1), 1, camera, 15)
    truth = run.capture.image(run.test[0], 1) / 255
    matte = run.capture.mask(run.test[0], 1) / 255
    assert np.abs(picture.rgb[:8, :8] - truth[:8, :8]).max() < 0.15
    assert np.abs(picture.foreground - matte).mean() < 0.15
    assert picture.alpha.mean() > 0.9
    alone = trained.renderer.render_background(camera, 15)
    assert np.abs(alone.rgb - 0.35).mean() < 0.1


def test_a_floor_at_a_grazing_angle_does_not_occlude_itself() -> None:
    """Catches discs of a floor that occlude the floor points behind them. The occluded points would lose their
    image-based colours and blur. The discs of the occluded points would then grow and occlude even more points."""
    x, y = torch.meshgrid(torch.arange(-1, 1, 0.02), torch.arange(-1, 3, 0.02), indexing="ij")
    xyz = torch.stack([x, y, torch.zeros_like(x)], -1).reshape(-1, 3)
    floor = FramePoints.initial(xyz, torch.full((len(xyz),), 0.02), 1.3, explicit_sh=False)
    size = 256
    intrinsics = np.array([[300.0, 0, size / 2], [0, 300, size / 2], [0, 0, 1]])
    viewer = look_at(np.array([0, -2.0, 0.3]), np.zeros(3), np.array([0, 0, 1.0]), intrinsics, size, size)
    pixels, depth = viewer.project(xyz.double().numpy())
    shown = ((pixels > 8) & (pixels < size - 8)).all(axis=1) & (depth > 0)
    column, row = np.clip(pixels, 0, size - 1).astype(int).T
    occlusion, surface = occlusion_depth(floor, viewer, 0.01).numpy(), surface_depth(floor, viewer, 0.01).numpy()
    assert ((depth - occlusion[row, column])[shown] < 2 * 0.02).mean() > 0.95
    assert ((depth - surface[row, column])[shown] < 2 * 0.02).mean() < 0.9
    assert (occlusion[row, column] < 1.3 * depth)[shown].mean() > 0.95


def test_points_behind_a_wall_are_hidden_and_a_floor_is_not(run: Run) -> None:
    """Catches the removal of floor points that nearer discs cover in every plate. Other cameras would see holes in the
    floor."""
    background = load_run(run.folder).renderer.background
    assert background is not None
    around = background.points
    x, y = torch.meshgrid(torch.arange(-3, 3, 0.1), torch.arange(-3, 3, 0.1), indexing="ij")
    # All cameras are at least 0.4 above the floor. If a camera were nearer to the floor than a disc's radius, one disc
    # would occlude all other discs.
    floor = torch.stack([x, y, torch.full_like(x, -0.6)], -1).reshape(-1, 3)
    beyond = 1.8 * around.xyz[:200]
    xyz = torch.cat([around.xyz, floor, beyond])
    spacing = torch.cat([around.spacing, torch.full((len(floor),), 0.1), torch.full((200,), 0.01)])
    background.points = FramePoints.initial(xyz, spacing, 1.3, explicit_sh=False, rgb=torch.zeros(len(xyz), 3))
    hidden = background.hidden_points()
    pictures = [background.camera(index) for index in background.plates]
    seen = ~outside_all_images(floor, pictures)
    assert float(hidden[len(around.xyz) : -200][seen].float().mean()) < 0.02
    assert hidden[-200:].all()


def test_without_joint_training_the_background_ignores_frames(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a background that is trained or densified in steps that render the foreground alone."""
    config = full_config(tmp_path / "shell.ply")
    separate = replace(config.background, joint=False, share=0.0)
    run = trained_run(ball_capture, tmp_path / "run", replace(config, background=separate))
    trained = load_run(run.folder)
    background = trained.renderer.background
    assert background is not None
    assert int(background.points.age) == 0
    assert len(background.points.xyz) == 1200
    picture = trained.renderer.render(trained.frames.get(1), 1, run.capture.cameras[run.test[0]], 15)
    assert 0 < picture.foreground.mean() < 0.9
    assert picture.alpha.mean() > 0.9


def test_cached_depths_of_plates_expire(run: Run) -> None:
    """Catches cached depths and features of plates that never expire, or that are recomputed in every step."""
    background = load_run(run.folder).renderer.background
    assert background is not None
    indices = list(background.plates)[:2]
    first = background.sources(indices)
    background.points.parameters["xyz"] *= 0.5
    background.count_step()
    cached = background.sources(indices)
    assert first.depth is not None
    assert cached.depth is not None
    assert torch.equal(first.depth, cached.depth)
    for _ in range(CACHED_STEPS):
        background.count_step()
    recomputed = background.sources(indices)
    assert recomputed.depth is not None
    torch.testing.assert_close(
        recomputed.depth[0], occlusion_depth(background.points, recomputed.cameras[0], background.near)
    )
    assert not torch.equal(recomputed.depth, first.depth)
    assert background.sources(indices, train_encoder=True).encoded is None


def test_held_out_views_have_no_plate(run: Run) -> None:
    """Catches plates of held-out views that are used in training."""
    made = sorted(path.stem for path in (run.folder / "background" / "plates").glob("*.png"))
    assert made == [run.capture.names[index] for index in run.training]


def test_the_capture_s_own_plates_are_used(ball_capture: Path, tmp_path: Path) -> None:
    """Catches plates that are computed although the capture contains plates."""
    capture = tmp_path / "capture"
    capture.mkdir()
    for name in ("images", "masks", "intri.yml", "extri.yml"):
        (capture / name).symlink_to(ball_capture / name)
    (capture / "bgs").mkdir()
    for index in range(8):
        assert cv2.imwrite(str(capture / "bgs" / f"{index:02d}.png"), np.full((64, 64, 3), 89, np.uint8))
    made = create_run(capture, tmp_path / "run", full_config(tmp_path / "shell.ply"))
    assert not (made.folder / "background" / "plates").exists()
    background = made.background(None)
    assert background is not None
    assert all(plate.seen.all() for plate in background.plates.values())


def test_an_empty_file_of_background_points_is_refused(ball_capture: Path, tmp_path: Path) -> None:
    (tmp_path / "none.ply").write_text(EMPTY_PLY)
    config = full_config(tmp_path / "shell.ply")
    config = replace(config, background=replace(config.background, seeds=tmp_path / "none.ply"))
    with pytest.raises(UserError, match=r"none.ply: expected points of the background, got none; use another PLY"):
        create_run(ball_capture, tmp_path / "run", config)


@pytest.mark.parametrize(("seeding", "why"), [("ngp", "cannot be measured"), ("sfm", "cannot be triangulated")])
def test_seeding_follows_the_config(
    seeding: Literal["ngp", "sfm"], why: str, ball_capture: Path, tmp_path: Path
) -> None:
    """Catches a setting ``seeding`` that has no effect. Each seeding method raises a different error for plates of one
    colour."""
    config = full_config(tmp_path / "shell.ply")
    config = replace(config, background=replace(config.background, seeds=None, seeding=seeding))
    with pytest.raises(UserError, match=rf"plates: expected at least 8 features .*{why}.*--background FILE.ply"):
        create_run(ball_capture, tmp_path / "run", config)
