"""Levels of the tiers: their order, points that are left out, and rounding of colours."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.scene import SceneReader, SceneWriter
from fourd.scene.files.encoding import Tier
from fourd.scene.packed.colours import mean_colours
from fourd.scene.packed.members import decode_cloud, encode_cloud, morton_sorted
from fourd.scene.packed.streams import stored
from fourd.scene.packing.bounds import check_bounds
from fourd.scene.packing.fit import fit_encoding, sample_cloud
from fourd.scene.packing.pack import measure_frames, pack_scene
from fourd.scene.packing.precision import DEFAULT_LEVELS, LEVELS, Precision
from fourd.scene.packing.rate import CANDIDATES
from fourd.scene.packing.visible import find_visible
from fourd.scene.rendering import render_frame
from fourd.scene.scene import BakedFrame, make_frame
from tests.baking.packing.test_pack import natural_frame
from tests.baking.scenes import manifest, random_frame, ring


def test_each_level_is_smaller_than_the_level_before(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches an order of levels in which the choice by data rate skips the best level that fits the rate."""
    with SceneWriter(tmp_path / "scene.4dv", manifest(6, 1)) as writer:
        writer.add_frame(0, natural_frame(3000, 6, rng))
    reader = SceneReader(tmp_path / "scene.4dv")
    for chosen in LEVELS:
        candidates = [level for tier, level in CANDIDATES if tier == chosen]
        sizes = [measure_frames(reader, [0], chosen, level) for level in candidates or range(len(LEVELS[chosen]))]
        assert len(sizes) >= 2
        assert all(after < before for before, after in itertools.pairwise(sizes)), sizes


@pytest.mark.parametrize("tier", list(LEVELS))
def test_levels_can_be_encoded(tier: Tier) -> None:
    """Catches colour steps that levels cannot represent, and a default that is not a level."""
    assert 0 <= DEFAULT_LEVELS[tier] < len(LEVELS[tier])
    for precision in LEVELS[tier]:
        assert precision.colour_step >= 2
        assert (precision.unseen_colour_step or 0) % precision.colour_step == 0


def with_hidden_points(rng: np.random.Generator) -> BakedFrame:
    """Return an opaque sphere of 3,000 points and 500 points near its centre."""
    frame = natural_frame(3500, 6, rng)
    xyz = frame.xyz.copy()
    xyz[3000:] *= 0.1
    return replace(frame, xyz=xyz, density=np.ones(3500, np.float16))


def test_hidden_points_are_left_out(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a visibility that keeps hidden points or drops visible ones, and a wrong number of points in the
    manifest."""
    frame, described = with_hidden_points(rng), manifest(6, 2)
    kept = find_visible(frame, described, 0.2)
    assert np.count_nonzero(kept >= 3000) < 10
    pruned = make_frame({name: array[kept] for name, array in frame.arrays.items()})
    for camera in described.cameras:
        difference = render_frame(frame, camera, described).rgb - render_frame(pruned, camera, described).rgb
        assert -10 * np.log10(np.square(difference).mean() + 1e-9) > 30
    with SceneWriter(tmp_path / "scene.4dv", described) as writer:
        writer.add_frame(0, frame)
        writer.add_frame(1, random_frame(40, 6, 1))
    pack_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", "stream", level=4)
    reader = SceneReader(tmp_path / "packed.4dv")
    assert reader.manifest.points[0] == len(kept) < 3100
    assert reader.read(0).point_count == len(kept)


def test_invisible_scenes_keep_nothing(tmp_path: Path) -> None:
    """Catches a minimum over no points if all points of all frames are left out."""
    frame = replace(random_frame(50, 6, 0), density=np.zeros(50, np.float16))
    with SceneWriter(tmp_path / "scene.4dv", manifest(6, 1)) as writer:
        writer.add_frame(0, frame)
    for tier in LEVELS:
        pack_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", tier, level=len(LEVELS[tier]) - 1)
        assert SceneReader(tmp_path / "packed.4dv").read(0).point_count in (0, 50)


def test_extreme_colours_are_within_the_bounds() -> None:
    """Catches differences from the mean colour that exceed a signed byte: a white occluder before a black point."""
    frame = random_frame(200, 4, 0)
    weights, rgb = np.zeros((200, 4), np.float16), np.zeros((200, 4, 3), np.uint8)
    weights[:, 0], rgb[:, 1], rgb[::2] = 1, 255, 255 - rgb[::2]
    frame = replace(frame, blend_weights=weights, rgb=rgb)
    precision = Precision(96, 64, 255, 1 / 64, 8, 2, unseen_colour_step=32)
    encoding, rounding = fit_encoding(sample_cloud(frame), precision), precision.colour_rounding
    order = morton_sorted(frame, encoding)
    ordered = make_frame({name: array[order] for name, array in frame.arrays.items()})
    members = encode_cloud(ordered, encoding, rounding)
    check_bounds(ordered, members, encoding, rounding, ring(4))
    changed = np.where(ordered.blend_weights[..., None] > 0, ordered.rgb, 255 - ordered.rgb)
    with pytest.raises(RuntimeError, match="rgb in unseen views: expected"):
        check_bounds(replace(ordered, rgb=changed), members, encoding, rounding, ring(4))


def test_colours_are_rounded_as_asked(rng: np.random.Generator) -> None:
    """Catches a reader and a writer that compute different colours from the mean colour."""
    frame = natural_frame(400, 5, rng)
    precision = Precision(96, 64, 255, 1 / 64, 8, 2, 10, unseen_colour_step=16)
    encoding, rounding = fit_encoding(sample_cloud(frame), precision), precision.colour_rounding
    order = morton_sorted(frame, encoding)
    ordered = make_frame({name: array[order] for name, array in frame.arrays.items()})
    members = encode_cloud(ordered, encoding, rounding)
    decoded = decode_cloud({name: stored(content) for name, content in members.items()}, 400, ring(5), encoding)
    mean = np.clip(np.rint(mean_colours(ordered) / 10) * 10, 0, 255)
    unseen = ordered.blend_weights == 0
    levels = (decoded["rgb"].astype(int) - mean[:, None])[unseen]
    inside = (decoded["rgb"][unseen] > 0) & (decoded["rgb"][unseen] < 255)
    assert np.all(levels[inside] % 16 == 0)
    assert np.abs(decoded["rgb"].astype(int) - ordered.rgb)[~unseen].max() <= 1
