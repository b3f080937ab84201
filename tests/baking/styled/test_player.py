"""Surfaces of baked frames, normals in scene files, and pictures in a style."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.play.op import MIN_TRANSMITTANCE
from fourd.rendering.ops.points.arrays import render_points_numpy
from fourd.rendering.ops.stylize.reference import front_weight
from fourd.scene import BakedFrame, SceneManifest, SceneReader, SceneWriter, combine_frames
from fourd.scene.packing.pack import pack_scene
from fourd.scene.shade import shade
from fourd.scene.styled.normals import FrameNormals, add_normals
from fourd.scene.styled.player import StyledPlayer
from fourd.scene.styles import PRESETS, decode_octahedral, load_style
from tests.baking.scenes import full_manifest, manifest, random_frame, room_frame

MANIFEST: SceneManifest = manifest()


@pytest.fixture
def frame() -> BakedFrame:
    return add_normals(random_frame(400, 6, seed=3), MANIFEST)


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512", ""])
def test_surfaces_equal_those_of_the_float_renderer(
    frame: BakedFrame, simd: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches normals in the wrong axes, and depths that are not divided by their weights. Also catches points that
    face away and hide other points, and colours over a background."""
    if simd and not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    camera = MANIFEST.cameras[1]
    assert frame.normals is not None
    normals = decode_octahedral(frame.normals) @ camera.rotation.T.astype(np.float32)
    position = frame.xyz @ camera.rotation.T + camera.translation
    cosine = -(normals * position).sum(1, keepdims=True) / np.linalg.norm(position, axis=1, keepdims=True)
    weight = front_weight(cosine)
    parts = [shade(frame, camera, MANIFEST), weight * normals, weight, weight * position[:, 2:]]
    features = np.concatenate(parts, axis=1).astype(np.float32)
    arrays = (frame.xyz, features, frame.radius.astype(np.float32), frame.density.astype(np.float32))
    try:
        values, alpha, _ = render_points_numpy(
            *arrays, camera, layers=12, near=MANIFEST.near, transmittance_min=MIN_TRANSMITTANCE
        )
    except ValueError as error:
        pytest.skip(str(error))  # this machine lacks the instruction set
    surface = StyledPlayer().draw_surface(frame, camera, MANIFEST, layers=12)
    coverage = np.clip(3 * alpha - 0.5, 0, 1)
    np.testing.assert_allclose(surface.albedo[..., :3] / 255, values[..., :3].clip(0, 1), atol=1.6 / 255)
    np.testing.assert_allclose(surface.albedo[..., 3] / 255, alpha, atol=0.6 / 255)
    np.testing.assert_allclose(surface.coverage, coverage, atol=0.6 / 255)
    depth = values[..., 7] / np.maximum(values[..., 6], 1e-12)
    np.testing.assert_allclose(surface.inverse_depth, coverage / np.where(alpha > 0, depth, 1), atol=1e-4)
    length = np.linalg.norm(values[..., 3:6], axis=2, keepdims=True)
    expected = values[..., 3:6] / np.maximum(length, 1e-6)
    clear = length[..., 0] > 0.05
    np.testing.assert_allclose(surface.unit_normal[clear], expected[clear], atol=0.02)
    empty = alpha == 0
    assert empty.any()
    assert (surface.normal[empty] == [128, 128, 128, 0]).all()
    assert np.isinf(surface.depth[empty]).all()


def test_a_resting_camera_averages_the_surface(frame: BakedFrame, rng: np.random.Generator) -> None:
    """Catches averaging over time that continues after the camera moves, and averaging of surfaces that move."""
    camera, other = MANIFEST.cameras[:2]
    noisy = replace(frame, xyz=frame.xyz + rng.normal(0, 0.004, frame.xyz.shape).astype(np.float32))
    fresh = StyledPlayer().draw_surface(noisy, camera, MANIFEST).inverse_depth.copy()
    player = StyledPlayer()
    first = player.draw_surface(frame, camera, MANIFEST).inverse_depth.copy()
    second = player.draw_surface(noisy, camera, MANIFEST, persistence=0.75).inverse_depth.copy()
    same = np.abs(first - fresh) <= 0.02 * fresh
    averaged = np.abs(second - (fresh + 0.75 * (first - fresh))) < 1e-5
    replaced = second == fresh
    assert (averaged | replaced).all()
    assert averaged[same].mean() > 0.5
    assert replaced[~same].all()
    player.draw_surface(frame, other, MANIFEST, persistence=0.75)
    again = player.draw_surface(noisy, camera, MANIFEST, persistence=0.75).inverse_depth
    np.testing.assert_array_equal(again, fresh)


@pytest.mark.parametrize("name", PRESETS)
def test_styles_draw_points_on_their_paper(frame: BakedFrame, name: str) -> None:
    """Catches a style that draws nothing, or that draws over the whole picture."""
    style = load_style(name)
    picture = StyledPlayer().draw(frame, MANIFEST.cameras[0], MANIFEST, style, background=(0.2, 0.4, 0.6))
    paper = np.round(255 * np.array(style.paper or (0.2, 0.4, 0.6))).astype(int)
    assert (np.abs(picture[0, 0, :3].astype(int) - paper) <= 1).all()
    assert picture[0, 0, 3] == 0
    assert picture[24, 24, 3] == 255
    assert (np.abs(picture[..., :3].astype(int) - paper).max(2) > 20).mean() > 0.05


def test_normals_are_stored_and_estimated_where_they_are_missing(tmp_path: Path) -> None:
    """Catches a scene without normals that cannot be drawn, and stored normals that are estimated again."""
    own, room = random_frame(60, 6, seed=1), room_frame(90, 6, seed=2)
    described = full_manifest(frames=1)
    with SceneWriter(tmp_path / "new.4dv", described) as writer:
        writer.add_background(add_normals(room, described, is_background=True))
        writer.add_frame(0, add_normals(own, described))
    with SceneWriter(tmp_path / "old.4dv", described) as writer:
        writer.add_background(room)
        writer.add_frame(0, own)
    new, old = (SceneReader(tmp_path / f"{name}.4dv") for name in ("new", "old"))
    stored, estimated = new.read(0), FrameNormals().get(old.read(0), old.manifest)
    assert new.manifest.version == old.manifest.version
    assert old.read(0).normals is None
    assert stored.normals is not None
    assert stored.normals.nbytes == 2 * 150
    np.testing.assert_array_equal(stored.normals, estimated)
    assert FrameNormals().get(stored, new.manifest) is stored.normals
    combined = combine_frames(add_normals(own, described), add_normals(room, described, is_background=True))
    np.testing.assert_array_equal(combined.normals, estimated)


def test_backgrounds_that_no_camera_sees_face_the_cameras(rng: np.random.Generator) -> None:
    """Catches walls and skies that are lit from behind, because their normals point away from the room."""
    described = full_manifest(frames=1)
    centre = np.mean([camera.centre for camera in described.source_cameras], axis=0)
    room = room_frame(600, 6, seed=int(rng.integers(1000)))
    outwards = rng.normal(size=(600, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    xyz = (centre + 50 * outwards).astype(np.float32)
    sky = replace(room, xyz=xyz, blend_weights=np.zeros_like(room.blend_weights))
    normals = add_normals(sky, described, is_background=True).normals
    assert normals is not None
    assert (decode_octahedral(normals) * outwards).sum(1).max() < -0.5


@pytest.mark.parametrize("tier", ["full", "light"])
def test_packed_scenes_have_no_normals(tmp_path: Path, tier: str) -> None:
    """Catches packed scenes that store normals, which makes them larger."""
    with SceneWriter(tmp_path / "scene.4dv", manifest(frames=1)) as writer:
        writer.add_frame(0, add_normals(random_frame(300, 6, seed=1), MANIFEST))
    pack_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", tier)
    packed = SceneReader(tmp_path / "packed.4dv")
    assert packed.manifest.optional_attributes == ()
    assert packed.read(0).normals is None


def test_tiles_that_become_empty_are_drawn_again() -> None:
    """The player skips tiles that were empty before. Catches tiles that keep the picture of points that have moved
    away, or of another camera."""
    left, right = (add_normals(random_frame(60, 6, seed=seed), MANIFEST) for seed in (5, 6))
    left, right = (replace(frame, xyz=frame.xyz * 0.2 + side) for frame, side in ((left, -0.4), (right, 0.4)))
    player, (first, second) = StyledPlayer(), MANIFEST.cameras[:2]
    steps = [(left, first), (right, first), (right, first), (left, first), (left, second), (right, second)]
    for frame, camera in [*steps, (left, first)]:
        found = player.draw_surface(frame, camera, MANIFEST, persistence=0.5)
        expected = StyledPlayer().draw_surface(frame, camera, MANIFEST)
        np.testing.assert_array_equal(found.albedo, expected.albedo)
        np.testing.assert_array_equal(found.coverage > 0, expected.coverage > 0)
        assert (expected.coverage == 0).mean() > 0.3
