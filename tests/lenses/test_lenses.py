"""Lenses, mirrors and glass balls. Directions are compared with known values. Pictures are compared with the rasterizer
and between devices.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from fourd.cli.main import main
from fourd.scene.gpu_player import GpuFrame
from fourd.scene.lenses.gpu_picture import draw_through_lens_gpu
from fourd.scene.lenses.inserts import GlassBall, MirrorFloor
from fourd.scene.lenses.lens import Fisheye, Lens, Panorama, Pinhole, ThinLens
from fourd.scene.lenses.picture import draw_through_lens
from fourd.scene.rendering import render_frame
from tests.baking.scenes import NEAR_IN_BALL, manifest, random_frame, ring, write_scene


@pytest.mark.parametrize("near", [0.01, NEAR_IN_BALL])
def test_a_pinhole_shows_the_picture_of_the_compositor(near: float) -> None:
    """Catches colours, a compositing order, a fade at the near plane or a pixel filter that differ from those of the
    rasterized picture."""
    frame, described = random_frame(4000, 6, seed=4), replace(manifest(views=6), near=near)
    for camera in ring(3, size=96):
        expected = render_frame(frame, camera, described, background=np.float32([0.2, 0.3, 0.4])).rgb
        found = draw_through_lens(frame, camera, described, Pinhole(), background=(0.2, 0.3, 0.4))
        assert np.abs(found - expected).mean() <= 1e-3


@pytest.mark.parametrize("lens", [Pinhole(), Fisheye(150.0, 2), Panorama(2), ThinLens(0.3, 3.0, rays_per_pixel=3)])
def test_a_gpu_draws_the_picture_of_the_cpu(lens: Lens, gpu: torch.device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a background, a filter, a near plane or averages over rays that differ between the GPU and the CPU."""
    monkeypatch.delenv("FOURD_SIMD", raising=False)
    frame, described = random_frame(1500, 6, seed=4), replace(manifest(views=6), near=NEAR_IN_BALL)
    camera = ring(3, size=32)[1]
    expected = draw_through_lens(frame, camera, described, lens, background=(0.2, 0.3, 0.4))
    held = GpuFrame.from_frame(frame, gpu)
    found = draw_through_lens_gpu(held, camera, described, lens, background=(0.2, 0.3, 0.4)).cpu().numpy()
    assert np.abs(found - expected).max() <= 1e-4
    assert expected.std() > 0.02


def test_fisheye_directions_have_their_angles() -> None:
    """Catches mirrored or transposed axes, and a full angle of view that is used as a half angle."""
    camera = ring(1, size=64)[0]
    rays = Fisheye(180.0).rays(camera)
    directions = dict(zip(rays.pixels.tolist(), rays.directions @ camera.rotation.T, strict=True))
    for row, column in ((32, 32), (32, 60), (10, 32), (50, 45)):
        offset = (np.array([column, row]) + 0.5 - 32) / 32
        angle = np.linalg.norm(offset) * np.pi / 2
        x, y, z = directions[row * 64 + column]
        assert np.isclose(z, np.cos(angle))
        assert np.allclose([x, y], np.sin(angle) * offset / np.linalg.norm(offset))
    assert 0 not in directions  # The corners of the image are outside the circle.


def test_panorama_directions_cover_the_sphere() -> None:
    """Catches a panorama that is upside down or turned, and a wrong angle of a column."""
    camera = ring(1)[0].resize(64, 32)
    rays = Panorama().rays(camera)
    local = (rays.directions @ camera.rotation.T).reshape(32, 64, 3)
    assert np.allclose(np.linalg.norm(local, axis=-1), 1)
    assert local[0, :, 1].max() < -0.99
    assert local[-1, :, 1].min() > 0.99
    assert local[16, 32, 2] > 0.99
    assert local[16, 48, 0] > 0.99
    assert local[16, 0, 2] < -0.99


def test_a_thin_lens_without_aperture_is_a_pinhole_and_its_plane_is_sharp() -> None:
    """Catches rays that do not meet in the focal plane."""
    camera = ring(1, size=16)[0]
    rays = ThinLens(0.5, 2.5, rays_per_pixel=40).rays(camera)
    depth = (rays.origins - camera.centre) @ camera.forward
    assert np.allclose(depth, 0)
    assert np.linalg.norm(rays.origins - camera.centre, axis=1).max() <= 0.25 + 1e-9
    pixels, _ = camera.project(rays.origins + 2.5 * rays.directions)
    assert np.abs(pixels - np.stack([rays.pixels % 16, rays.pixels // 16], 1) - 0.5).max() <= 0.5 + 1e-9
    closed = ThinLens(0.0, 2.5).rays(camera)
    assert np.allclose(closed.origins, camera.centre)


def test_a_mirror_shows_the_mirrored_scene() -> None:
    """Catches reflections about the wrong side of the mirror, and a floor that is seen from below."""
    frame, described = random_frame(4000, 6, seed=4), manifest(views=6)
    camera = ring(3, size=96)[1]
    floor = MirrorFloor(np.array([0, 0, -0.5]), np.array([0, 0, 1.0]), 50.0, reflectivity=1.0)
    points = camera.centre[None] + np.array([[0.0, 0, 0]])
    down = np.array([[0.3, 0, -1.0]])
    (branch,), light = floor.leave(points + floor.hits(points, down)[:, None] * down, down)
    assert np.allclose(branch.directions, [[0.3, 0, 1.0]])
    assert not light.any()
    assert np.isinf(floor.hits(np.array([[0, 0, -2.0]]), np.array([[0, 0, 1.0]]))).all()
    picture = draw_through_lens(frame, camera, described, Pinhole(), inserts=[floor])
    plain = draw_through_lens(frame, camera, described, Pinhole())
    assert picture[60:].mean() > plain[60:].mean() + 0.01  # The reflection is below the ball of points.
    assert np.abs(picture[:30] - plain[:30]).max() <= 1e-6


def test_a_ball_without_refraction_is_nearly_invisible() -> None:
    """Catches wrong signs in Snell's law: with an index of 1, rays pass straight through."""
    ball = GlassBall(np.zeros(3), 1.0, refractive_index=1.0 + 1e-9)
    rng = np.random.default_rng(0)
    origins = rng.normal(0, 0.4, (50, 3)) + np.array([0, 0, -3])
    directions = np.array([0, 0, 1.0]) + rng.normal(0, 0.05, (50, 3))
    t = ball.hits(origins, directions)
    kept = np.isfinite(t)
    points = origins[kept] + t[kept, None] * directions[kept]
    (_, passed), _ = ball.leave(points, directions[kept])
    unit = directions[kept] / np.linalg.norm(directions[kept], axis=1, keepdims=True)
    assert kept.sum() > 20
    assert np.allclose(passed.directions, unit, atol=1e-6)


def test_glass_bends_rays_towards_its_centre() -> None:
    """Catches an exit ray on the wrong side: parallel rays near the axis meet at the focal length n R / (2 (n - 1))."""
    ball = GlassBall(np.zeros(3), 1.0, refractive_index=1.5)
    origins = np.array([[0.01, 0, -5.0], [0, -0.02, -5.0]])
    directions = np.tile([0, 0, 1.0], (2, 1))
    t = ball.hits(origins, directions)
    (_, passed), _ = ball.leave(origins + t[:, None] * directions, directions)
    at = passed.origins + (1.5 - passed.origins[:, 2:]) / passed.directions[:, 2:] * passed.directions
    assert np.abs(at[:, :2]).max() <= 1e-4


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene file of three random frames."""
    path = tmp_path_factory.mktemp("lenses") / "scene.4dv"
    write_scene(path, points=2000)
    return path


@pytest.mark.parametrize(
    "options",
    [
        ["--lens", "fisheye", "--fov", "120"],
        ["--lens", "panorama"],
        ["--lens", "thin-lens", "--lens-samples", "4"],
        ["--mirror-floor", "--glass-ball", "auto"],
        ["--glass-ball", "0,0,0,0.4"],
    ],
)
def test_the_command_writes_pictures(options: list[str], scene: Path, tmp_path: Path) -> None:
    """Catches options that have no effect on the lens, and black pictures."""
    out = tmp_path / "out"
    view = ["--views", "00", "--frames", "11:12", "--size", "64", "48"]
    assert main(["render", str(scene), "-o", str(out), *view, *options]) == 0
    (file,) = out.rglob("*.png")
    picture = cv2.imread(str(file))
    assert picture is not None
    assert picture.shape == (48, 64, 3)
    assert picture.std() > 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--lens", "fisheye", "--fov", "400"], "--fov: expected more than 0 and at most 360 degrees, got 400"),
        (["--lens", "thin-lens", "--aperture", "-1"], "--aperture: expected a diameter of at least 0, got -1"),
        (["--lens", "thin-lens", "--focus-distance", "nan"], "--focus-distance: expected a distance above 0, got nan"),
        (["--lens", "pinhole", "--lens-samples", "0"], "--lens-samples: expected 1 to 64, got 0"),
        (["--glass-ball", "1,2,3"], "--glass-ball: expected auto or four numbers X,Y,Z,R, got '1,2,3'"),
        (["--glass-ball", "1,2,3,-1"], "--glass-ball: expected finite numbers and a radius above 0"),
        (["--lens", "panorama", "--style", "toon"], "--style, --lens: expected one of them, got both"),
    ],
)
def test_wrong_options_are_one_line(
    options: list[str], message: str, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches tracebacks, and options that are silently ignored."""
    assert main(["render", str(scene), "-o", str(tmp_path / "out"), "--views", "00", *options]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
