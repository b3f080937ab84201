"""Tests of packed scenes: quantisation errors, sizes, the index of members, and damaged files."""

from __future__ import annotations

import json
import struct
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard

from fourd.base.errors import UserError
from fourd.rendering.ops.morton import gather_bits, spread_bits
from fourd.scene import BakedFrame, SceneReader, open_scene
from fourd.scene.files.encoding import Tier
from fourd.scene.packed.colours import fill_unseen_colours, mean_colours
from fourd.scene.packed.members import encode_cloud, morton_sorted, view_member
from fourd.scene.packing.bounds import check_bounds
from fourd.scene.packing.fit import fit_encoding, sample_cloud
from fourd.scene.packing.pack import pack_scene
from fourd.scene.packing.precision import LEVELS
from fourd.scene.scene import make_frame
from tests.baking.damage import damage
from tests.baking.scenes import manifest, random_frame, ring, write_full_scene, write_scene
from tests.baking.test_container import rewritten, with_manifest

TIERS: tuple[Tier, ...] = ("full", "stream", "video", "light")


def natural_frame(points: int, views: int, rng: np.random.Generator) -> BakedFrame:
    """Return a sphere of points that resemble the points of a trained scene, with smooth colours and views that see
    half of the sphere."""
    normal = rng.normal(size=(points, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    frame = random_frame(points, views, seed=int(rng.integers(2**31)))
    seen = rng.random((points, views)) < 0.5
    base = np.clip(128 + 80 * normal + rng.normal(0, 5, (points, 3)), 0, 255)
    rgb = np.clip(base[:, None] + rng.normal(0, 8, (points, views, 3)), 0, 255).astype(np.uint8)
    terms = np.zeros((points, 3, 16))
    terms[..., :4] = normal[:, :1, None] * rng.uniform(0.15, 0.6, size=4) * rng.choice([-1, 1], size=4)
    return replace(
        frame,
        xyz=(0.4 * normal).astype(np.float32),
        sh=terms.astype(np.float16),
        blend_weights=np.where(seen, frame.blend_weights, 0).astype(np.float16),
        rgb=rgb,
    )


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.4dv"
    write_scene(path)
    return path


def test_bits_are_spread_and_gathered(rng: np.random.Generator) -> None:
    """Catches a wrong mask in the Morton code of one of the 21 bits."""
    values = np.concatenate([2 ** np.arange(21), rng.integers(0, 2**21, 1000)]).astype(np.uint64)
    spread = spread_bits(values)
    expected = [sum((int(value) >> bit & 1) << 3 * bit for bit in range(21)) for value in values]
    assert spread.tolist() == expected
    np.testing.assert_array_equal(gather_bits(spread | spread << np.uint64(1) | spread << np.uint64(2)), values)


@pytest.mark.parametrize("tier", ["full", "stream"])
def test_errors_are_within_the_bounds(tier: Tier, rng: np.random.Generator) -> None:
    """Catches a wrong scale, a wrong order of points, and a check of error bounds that accepts every array."""
    frame = natural_frame(500, 5, rng)
    precision = LEVELS[tier][0]
    encoding, rounding = fit_encoding(sample_cloud(frame), precision), precision.colour_rounding
    order = morton_sorted(frame, encoding)
    ordered = make_frame({name: array[order] for name, array in frame.arrays.items()})
    members = encode_cloud(ordered, encoding, rounding)
    check_bounds(ordered, members, encoding, rounding, ring(5))
    for name in ("xyz", "radius", "density", "sh", "blend_weights", "rgb"):
        array = ordered.arrays[name]
        changed = replace(ordered, **{name: np.roll(array, 7, axis=0)})
        with pytest.raises(RuntimeError, match=f"{name}: expected"):
            check_bounds(changed, members, encoding, rounding, ring(5))


@pytest.mark.parametrize("tier", TIERS)
def test_a_packed_scene_looks_like_its_source(tier: Tier, tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches errors in packing, reading or rendering. The tier light keeps only smooth colours, so its limit is
    lower.
    """
    from fourd.scene import SceneWriter

    source, out = tmp_path / "scene.4dv", tmp_path / "packed.4dv"
    with SceneWriter(source, manifest(6, 1)) as writer:
        writer.add_frame(0, fill_unseen_colours(natural_frame(3000, 6, rng)))
    pack_scene(source, out, tier)
    before, after = open_scene(source), open_scene(out)
    for camera in before.manifest.cameras:
        difference = before.render(camera, 0).rgb - after.render(camera, 0).rgb
        error_db = -10 * np.log10(np.square(difference).mean())
        assert error_db > {"full": 45, "stream": 36, "video": 34, "light": 28}[tier]


@pytest.mark.parametrize("tier", TIERS)
def test_a_whole_scene_keeps_background_and_shadows(tier: Tier, tmp_path: Path) -> None:
    """Catches shadows that stay in the order of the unsorted background points."""
    source, out = tmp_path / "scene.4dv", tmp_path / "packed.4dv"
    write_full_scene(source, background_points=30)
    pack_scene(source, out, tier)
    before, after = SceneReader(source), SceneReader(out)
    assert after.manifest.kind == "full"
    assert after.manifest.background == before.manifest.background
    old, new = before.read_background(), after.read_background()
    assert old is not None
    assert new is not None
    nearest = np.linalg.norm(new.xyz[:, None] - old.xyz[None], axis=-1).argmin(axis=1)
    assert sorted(nearest) == list(range(len(nearest)))
    for index in range(3):
        shadow, packed = before.read_shadow(index), after.read_shadow(index)
        assert shadow is not None
        assert packed is not None
        np.testing.assert_array_equal(packed, shadow[nearest])


def test_the_manifest_comes_first_and_locates_all_members(scene: Path, tmp_path: Path) -> None:
    """Catches offsets that do not point to the members' data, and a checksum of the manifest that is out of date."""
    out = tmp_path / "packed.4dv"
    pack_scene(scene, out, "stream")
    content = out.read_bytes()
    name_size, extra_size = struct.unpack_from("<2H", content, 26)
    (size,) = struct.unpack_from("<L", content, 22)
    assert content[30 : 30 + name_size] == b"manifest.json"
    start = 30 + name_size + extra_size
    located = json.loads(content[start : start + size])["members"]
    with zipfile.ZipFile(out) as archive:
        assert archive.testzip() is None
        assert set(located) == set(archive.namelist()) - {"manifest.json"}
        for name, (offset, length) in located.items():
            assert content[offset : offset + length] == archive.read(name)


def test_packing_again_and_twice_gives_the_same_bytes(scene: Path, tmp_path: Path) -> None:
    """Catches times or random numbers in the file."""
    one, two = tmp_path / "one.4dv", tmp_path / "two.4dv"
    pack_scene(scene, one, "full")
    pack_scene(scene, two, "full")
    assert one.read_bytes() == two.read_bytes()


def test_a_scene_is_packed_in_place(scene: Path) -> None:
    """Catches a writer that truncates the file that it still reads."""
    size = scene.stat().st_size
    pack_scene(scene, scene, "stream")
    assert scene.stat().st_size < size
    assert SceneReader(scene).read(2).point_count == 202


def test_frames_without_points_are_packed(tmp_path: Path) -> None:
    """Catches a minimum over no points."""
    from fourd.scene import SceneWriter

    source, out = tmp_path / "scene.4dv", tmp_path / "packed.4dv"
    with SceneWriter(source, manifest(3, 2)) as writer:
        writer.add_frame(0, random_frame(0, 3, 0))
        writer.add_frame(1, random_frame(0, 3, 1))
    for tier in TIERS:
        pack_scene(source, out, tier)
        assert SceneReader(out).read(1).point_count == 0


def test_a_scene_without_frames_is_refused(tmp_path: Path) -> None:
    """Catches a traceback from computing the bounds of a scene without points."""
    from fourd.scene import SceneWriter

    with SceneWriter(tmp_path / "scene.4dv", manifest(3, 0)):
        pass
    with pytest.raises(UserError, match="expected a scene with at least one frame, got none"):
        pack_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", "full")
    assert not (tmp_path / "packed.4dv").exists()


def test_unseen_views_get_the_mean_of_the_seen_ones() -> None:
    """Catches means that include the colours of surfaces that occlude the point."""
    frame = random_frame(3, 3, 0)
    weights = np.array([[1, 3, 0], [0, 0, 0], [2, 0, 0]], np.float16)
    rgb = np.zeros((3, 3, 3), np.uint8)
    rgb[:, 0], rgb[:, 1], rgb[:, 2] = 10, 50, 255
    filled = fill_unseen_colours(replace(frame, blend_weights=weights, rgb=rgb))
    assert mean_colours(filled)[0].tolist() == [40, 40, 40]
    assert filled.rgb[..., 0].tolist() == [[10, 50, 40], [105, 105, 105], [10, 10, 10]]


def test_a_member_that_declares_gigabytes_is_refused(scene: Path, tmp_path: Path) -> None:
    """Catches a decompression bomb: memory must not be taken before the declared size is checked."""
    out = tmp_path / "packed.4dv"
    pack_scene(scene, out, "stream")
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 26))
    for name in ("points", "sh", "colour", view_member(2)):
        path = rewritten(out, lambda members, name=name: members.update({f"frames/000001/{name}": bomb}))
        with pytest.raises(UserError, match=r"expected at most \d+ bytes in frames/000001, got 67108864; the file is"):
            SceneReader(path).read(1)


def test_damaged_members_are_named(scene: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a damaged member that causes a traceback, or that is read as wrong arrays of the correct shape."""
    out = tmp_path / "packed.4dv"
    pack_scene(scene, out, "full")
    changes = {
        "other content": b"no zstd",
        "bytes of": zstandard.ZstdCompressor().compress(b"short"),
        "empty": b"",
    }
    for content in changes.values():
        path = rewritten(out, lambda members, content=content: members.update({"frames/000000/points": content}))
        with pytest.raises(UserError, match=r"frames/000000.*copy or export it again"):
            SceneReader(path).read(0)
    path = rewritten(out, lambda members: members.pop("frames/000000/views/003"))
    with pytest.raises(UserError, match="expected a member frames/000000/views/003, got none"):
        SceneReader(path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("position_bits", 22, "a whole number <= 21, got 22"),
        ("density_levels", 0, "a whole number >= 1, got 0"),
        ("colour_step", 128, "a whole number <= 127, got 128"),
        ("sh_rows", 49, "48, got 49"),
        ("sh_step", float("nan"), "a number >= 1e-09, got nan"),
        ("lower", [0, 0], r"3 finite numbers, got an array of shape \(2,\)"),
        ("every_point_has_colours", 1, "true or false, got 1"),
    ],
)
def test_an_invalid_encoding_is_named(scene: Path, tmp_path: Path, key: str, value: object, message: str) -> None:
    """Catches an encoding that the reader passes to the decoder without a check."""
    out = tmp_path / "packed.4dv"
    pack_scene(scene, out, "stream")
    path = with_manifest(out, lambda content: content["encoding"]["dynamic"].update({key: value}))
    with pytest.raises(UserError, match=f"dynamic, {key}: expected {message}"):
        SceneReader(path)


@pytest.mark.slow
def test_random_damage_never_escapes(scene: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a crash, an endless loop or an exception other than UserError for any change of up to 20 bytes."""
    out, damaged = tmp_path / "packed.4dv", tmp_path / "damaged.4dv"
    pack_scene(scene, out, "stream")
    content = out.read_bytes()
    for _ in range(10_000):
        damaged.write_bytes(damage(content, rng, 20))
        try:
            reader = SceneReader(damaged)
            for index in range(3):
                reader.read(index)
        except UserError as error:
            assert "\n" not in str(error)  # noqa: PT017


def test_members_before_the_start_of_the_file_are_rejected(scene: Path) -> None:
    """Catches a traceback from seeking to a negative offset. Damaged directories contain such offsets."""
    content = bytearray(scene.read_bytes())
    end = content.rindex(b"PK\x05\x06")
    (directory,) = struct.unpack_from("<L", content, end + 16)
    struct.pack_into("<L", content, end + 16, directory + 2000)
    scene.write_bytes(content)
    with pytest.raises(UserError, match=r"expected members inside the file, got '.*' at byte -"):
        open_scene(scene)
