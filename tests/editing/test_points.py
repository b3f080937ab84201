"""Edits of points: regions, floaters, colours and similarity transforms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fourd.base.errors import UserError
from fourd.scene import open_scene
from fourd.scene.editing.floaters import keep_large_parts
from fourd.scene.editing.regions import Box, Cylinder, HalfSpace
from fourd.scene.editing.similarity import Similarity
from fourd.scene.editing.tint import Tint
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.shade import shade
from fourd.scene.styles.normals import decode_octahedral, encode_octahedral
from tests.baking.scenes import manifest, random_frame, write_scene

Z = np.array([0.0, 0, 1])


def a_similarity(seed: int) -> Similarity:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    return Similarity(float(rng.uniform(0.3, 3)), rotation, rng.normal(0, 2, 3))


def with_normals(frame: BakedFrame, seed: int) -> BakedFrame:
    directions = np.random.default_rng(seed).normal(size=(frame.point_count, 3)).astype(np.float32)
    return replace(frame, normals=encode_octahedral(directions / np.linalg.norm(directions, axis=1, keepdims=True)))


def test_regions_contain_what_they_say() -> None:
    """Catches a region that is inside out, and a cylinder whose axis does not go through its centre."""
    xyz = np.array([[0, 0, 0], [2, 0, 0], [0, 0, 5], [1, 1, -5]], np.float32)
    assert Box(np.array([-1.0, -1, -1]), np.array([1.0, 1, 9])).contains(xyz).tolist() == [True, False, True, False]
    assert Cylinder(np.array([1.0, 1, 0]), Z, 1.2).contains(xyz).tolist() == [False, False, False, True]
    assert HalfSpace(Z, 0.0).contains(xyz).tolist() == [True, True, True, False]


def test_floaters_are_apart_and_small() -> None:
    """Catches a search that removes thin parts that touch the subject, keeps specks, or fails on a frame without
    points."""
    rng = np.random.default_rng(0)
    body = rng.normal(size=(4000, 3))
    body /= np.linalg.norm(body, axis=1, keepdims=True)
    arm = np.stack([np.linspace(1, 2, 60), *rng.normal(0, 0.01, (2, 60))], axis=1)
    speck = rng.normal(0, 0.02, (30, 3)) + np.array([0, 0, 3])
    twin = rng.normal(0, 0.3, (400, 3)) + np.array([0, 5, 0])
    xyz = np.concatenate([body, arm, speck, twin]).astype(np.float32)
    kept = keep_large_parts(xyz, 0.02)
    assert kept[:4060].all()
    assert not kept[4060:4090].any()
    assert kept[4090:].mean() > 0.9
    assert keep_large_parts(np.zeros((0, 3), np.float32)).shape == (0,)
    assert keep_large_parts(xyz[:3]).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_moved_scene_looks_the_same_from_moved_cameras(tmp_path: Path, seed: int) -> None:
    """Catches colours, normals, radii, cameras or a near plane that do not follow the points."""
    similarity = a_similarity(seed)
    write_scene(tmp_path / "scene.4dv", frames=1)
    with open_scene(tmp_path / "scene.4dv") as scene:
        before, frame = scene.manifest, scene.frame(0)
    after = similarity.manifest(before)
    moved = similarity.frame(with_normals(frame, seed))
    for camera, other in zip(before.cameras, after.cameras, strict=True):
        expected, got = shade(frame, camera, before), shade(moved, other, after)
        assert np.abs(expected - got).max() < 0.01
        assert np.allclose(similarity.points(camera.centre[None])[0], other.centre, atol=1e-6)
    assert after.near == pytest.approx(similarity.scale * before.near)
    assert moved.normals is not None
    expected_normals = decode_octahedral(with_normals(frame, seed).normals) @ similarity.rotation.T
    assert (expected_normals * decode_octahedral(moved.normals)).sum(axis=1).min() > 0.99


def test_transforms_follow_one_another() -> None:
    """Catches transforms that are applied in the wrong order."""
    one, two = a_similarity(3), a_similarity(4)
    xyz = np.random.default_rng(0).normal(size=(5, 3))
    assert np.allclose(one.then(two).points(xyz), two.points(one.points(xyz)))


def test_radii_that_cannot_be_stored_are_refused() -> None:
    """Catches a scale that makes points vanish or infinite without a word."""
    frame = random_frame(10, 2, seed=0)
    for scale in (1e-9, 1e9):
        with pytest.raises(UserError, match="--scale: expected radii from 6e-8 to 65504"):
            Similarity(scale, np.eye(3), np.zeros(3)).frame(frame)


def light_manifest() -> SceneManifest:
    before = manifest(0, 1)
    return replace(before, sh_base=0.5, sh_range=1.0)


def colours(frame: BakedFrame, manifest: SceneManifest) -> NDArray[np.float32]:
    return shade(frame, manifest.cameras[0], manifest)


@pytest.mark.parametrize("views", [0, 4])
def test_brightness_multiplies_all_colours(views: int) -> None:
    """Catches a brightness that changes only the colours of the source views, or only the harmonics."""
    before = light_manifest() if views == 0 else manifest(views, 1)
    frame = random_frame(300, views, seed=1)
    for gain in (0.4, 1.7):
        tint = Tint((gain, gain, gain))
        got = colours(tint.frame(frame, before), tint.manifest(before))
        if views == 0 or gain < 1:
            assert np.abs(got - gain * colours(frame, before)).max() < 0.01
        else:
            assert np.abs(got - gain * colours(frame, before)).mean() > 0.01  # white is clipped


def test_gains_of_channels_multiply_colours_of_harmonics() -> None:
    """Catches gains that are applied to the harmonics instead of to the colour, whose base is not 0."""
    before, tint = light_manifest(), Tint((1.2, 0.6, 1.0))
    frame = random_frame(300, 0, seed=2)
    frame = replace(frame, sh=(frame.sh * 0.2).astype(np.float16))
    got, expected = colours(tint.frame(frame, before), tint.manifest(before)), colours(frame, before) * tint.gains
    assert np.abs(got - expected).mean() < 0.01
    assert np.abs(got - expected).max() < 0.05
