"""Full scenes in a `.4dv`: a background that is stored once, shadows on this background, and combined frames."""

from __future__ import annotations

import zipfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.scene import BakedFrame, SceneBackground, SceneReader, SceneWriter, combine_frames, open_scene
from fourd.scene.attributes import ATTRIBUTES
from tests.baking.scenes import full_manifest, manifest, random_frame, room_frame, write_full_scene, write_scene
from tests.baking.test_container import rewritten, with_manifest

BACKGROUND_POINTS = 300
VIEWS = 6


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "full.4dv"
    write_full_scene(path, background_points=BACKGROUND_POINTS)
    return path


def cast_shadow(rgb: NDArray[np.uint8], shadow: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Multiply colours by a shadow in floating point, and round half up."""
    return np.minimum(np.floor(rgb.astype(float) * shadow[:, None, None] / 128 + 0.5), 255).astype(np.uint8)


def assert_same(got: BakedFrame, expected: BakedFrame) -> None:
    for attribute in expected.attributes:
        np.testing.assert_array_equal(getattr(got, attribute.name), getattr(expected, attribute.name))


@pytest.mark.parametrize("shadow", [True, False])
def test_frames_are_read_with_the_background_after_them(tmp_path: Path, shadow: bool) -> None:
    """Catches background points before the dynamic points, the shadow of a wrong frame, and missing attributes."""
    dynamic, room, shadows = write_full_scene(tmp_path / "full.4dv", background_points=BACKGROUND_POINTS, shadow=shadow)
    reader = SceneReader(tmp_path / "full.4dv")
    assert reader.manifest.points == (200, 201, 202)
    assert reader.manifest.background == SceneBackground(BACKGROUND_POINTS, shadow)
    assert (reader.manifest.kind, reader.manifest.version) == ("full", 2)
    for index in (2, 0, 1):
        frame, own = reader.read(index), dynamic[index]
        rgb = cast_shadow(room.rgb, shadows[index]) if shadow else room.rgb
        for attribute in own.attributes:
            other = rgb if attribute.name == "rgb" else getattr(room, attribute.name)
            expected = np.concatenate([getattr(own, attribute.name), other])
            np.testing.assert_array_equal(getattr(frame, attribute.name), expected)
        assert_same(reader.read_dynamic(index), own)
    background = reader.read_background()
    assert background is not None
    assert_same(background, room)


def test_an_object_scene_has_no_background(tmp_path: Path) -> None:
    """Catches a reader that returns a background or a shadow for a scene without a background."""
    written = write_scene(tmp_path / "object.4dv")
    reader = SceneReader(tmp_path / "object.4dv")
    assert reader.read_background() is None
    assert reader.read_shadow(0) is None
    assert_same(reader.read_dynamic(1), written[1])
    assert reader.manifest.background_nbytes == 0
    assert reader.manifest.frame_nbytes(1) == reader.read(1).nbytes


def test_the_background_is_stored_once_without_shadow(scene: Path) -> None:
    """Catches a background that is stored with every frame, and shadows baked into the background."""
    with zipfile.ZipFile(scene) as archive:
        names = archive.namelist()
        room = room_frame(BACKGROUND_POINTS, VIEWS, seed=100)
        assert archive.read("background/rgb") == room.rgb.tobytes()
        assert archive.getinfo("frames/000001/shadow").file_size == BACKGROUND_POINTS
    assert sorted(names) == sorted(
        [
            "manifest.json",
            *(f"background/{item.name}" for item in room.attributes),
            *(f"frames/{index:06d}/{item.name}" for index in range(3) for item in room.attributes),
            *(f"frames/{index:06d}/shadow" for index in range(3)),
        ]
    )


def test_every_shadow_value_on_every_colour() -> None:
    """Catches 8-bit overflow, results that are rounded down, and colours above 255 that wrap around to black."""
    room = room_frame(256, 1, seed=1)
    room.rgb[:] = np.arange(256, dtype=np.uint8)[:, None, None]
    empty = random_frame(0, 1, seed=0)
    for value in range(256):
        shadow = np.full(256, value, np.uint8)
        np.testing.assert_array_equal(combine_frames(empty, room, shadow).rgb, cast_shadow(room.rgb, shadow))
    half = combine_frames(empty, room, np.full(256, 64, np.uint8)).rgb
    assert half[[0, 1, 2, 3, 255], 0, 0].tolist() == [0, 1, 1, 2, 128]
    assert combine_frames(empty, room, np.full(256, 192, np.uint8)).rgb[[100, 170, 171], 0, 0].tolist() == [
        150,
        255,
        255,
    ]


def test_a_shadow_changes_only_the_background() -> None:
    """Catches shadows on dynamic points, a background that is modified in place, and errors at chunk borders."""
    own, room = random_frame(40, 2, seed=1), room_frame(5000, 2, seed=2)
    before = room.rgb.copy()
    shadow = np.random.default_rng(3).choice(np.array([128, 60, 200], np.uint8), 5000)
    frame = combine_frames(own, room, shadow)
    np.testing.assert_array_equal(frame.rgb[:40], own.rgb)
    np.testing.assert_array_equal(frame.rgb[40:], cast_shadow(before, shadow))
    np.testing.assert_array_equal(room.rgb, before)


def test_invalid_arguments_of_combining_are_named() -> None:
    """Catches a shadow of the wrong shape that is truncated, broadcast or reported by a raw NumPy error."""
    own, room = random_frame(5, 2, seed=1), room_frame(8, 2, seed=2)
    with pytest.raises(ValueError, match="background: expected 2 source views, got 3"):
        combine_frames(own, room_frame(8, 3, seed=2))
    for shadow in (np.full(1, 128, np.uint8), np.full(9, 128, np.uint8), np.ones(8)):
        with pytest.raises(ValueError, match=r"shadow: expected uint8 of shape \(8,\), got"):
            combine_frames(own, room, shadow)


def test_combined_frames_are_read_only(scene: Path) -> None:
    """Catches frames with writable arrays. With writable arrays, a caller could modify a cached frame that other
    callers use."""
    frame = SceneReader(scene).read(0)
    for attribute in frame.attributes:
        assert not getattr(frame, attribute.name).flags.writeable, attribute.name


@pytest.mark.parametrize(("points", "background_points", "views"), [(0, 50, 2), (50, 0, 2), (0, 0, 2), (50, 50, 0)])
def test_empty_frames_and_backgrounds(tmp_path: Path, points: int, background_points: int, views: int) -> None:
    """Catches errors from arrays of zero bytes, as in an empty frame, an empty background or a scene without source
    views."""
    with SceneWriter(tmp_path / "full.4dv", full_manifest(views, 1)) as writer:
        writer.add_frame(0, random_frame(points, views, seed=0), np.full(background_points, 64, np.uint8))
        writer.add_background(room_frame(background_points, views, seed=1))
    with open_scene(tmp_path / "full.4dv") as opened:
        assert opened.frame(0).point_count == points + background_points
        opened.render(opened.manifest.other_cameras[0], 0)


@pytest.mark.parametrize("place", [0, 1, 3])
def test_the_background_may_be_added_at_any_time(tmp_path: Path, place: int) -> None:
    """Catches a writer that does not check shadows added before the background."""
    room = room_frame(30, VIEWS, seed=1)
    with SceneWriter(tmp_path / "full.4dv", full_manifest()) as writer:
        for index in range(4):
            if index == place:
                writer.add_background(room)
            if index < 3:
                writer.add_frame(index, random_frame(5, VIEWS, seed=index), np.full(30, 100 + index, np.uint8))
    reader = SceneReader(tmp_path / "full.4dv")
    np.testing.assert_array_equal(reader.read(2).rgb[5:], cast_shadow(room.rgb, np.full(30, 102, np.uint8)))


Steps = Callable[[SceneWriter], object]


def _frame(index: int, shadow: NDArray[Any] | None = None) -> Steps:
    return lambda writer: writer.add_frame(index, random_frame(5, VIEWS, seed=index), shadow)


def _room(points: int = 30, views: int = VIEWS) -> Steps:
    return lambda writer: writer.add_background(room_frame(points, views, seed=1))


def _invalid_room(writer: SceneWriter) -> None:
    room = room_frame(30, VIEWS, seed=1)
    room.sh.flat[7] = np.nan
    writer.add_background(room)


SHADOW = np.full(30, 128, np.uint8)


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([_room(), _room()], "background: expected one background, got a second one"),
        ([_room(views=5)], "background: expected 6 source views, got 5"),
        ([_invalid_room], "background, sh: expected finite numbers"),
        ([_frame(0, SHADOW), _room(31)], "background: expected 30 points to match the frames' shadows, got 31"),
        (
            [_room(), _frame(0, SHADOW[:29])],
            r"frame 0, shadow: expected uint8 of shape \(30,\), got uint8 of shape \(29,\)",
        ),
        ([_frame(0, SHADOW), _frame(1, SHADOW[:29])], r"frame 1, shadow: expected uint8 of shape \(30,\)"),
        ([_frame(0, SHADOW.astype(float))], r"frame 0, shadow: expected uint8 of shape \(M,\), got float64"),
        (
            [_room(), _frame(0, SHADOW[:, None])],
            r"shadow: expected uint8 of shape \(30,\), got uint8 of shape \(30, 1\)",
        ),
        ([_frame(0, SHADOW), _frame(1)], "frame 1: expected a shadow, because the previous frames have one"),
        ([_frame(0), _frame(1, SHADOW)], "frame 1: expected no shadow, because the previous frames have none"),
        ([_frame(0), _frame(1), _frame(2)], 'expected a background in a scene of kind "full", got none; call add'),
        ([_room(), _frame(0)], "expected 3 frames, got 1"),
    ],
)
def test_inconsistent_writing_is_an_error(tmp_path: Path, steps: list[Steps], words: str) -> None:
    """Catches a writer that creates a file which the reader rejects."""
    with pytest.raises(ValueError, match=words), SceneWriter(tmp_path / "full.4dv", full_manifest()) as writer:
        for step in steps:
            step(writer)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("step", [_room(), _frame(0, SHADOW)])
def test_an_object_scene_accepts_no_background(tmp_path: Path, step: Steps) -> None:
    """Catches a background or shadow that the manifest does not describe."""
    with (
        pytest.raises(ValueError, match=r'expected no (background|shadow) in a scene of kind "object", got one'),
        SceneWriter(tmp_path / "object.4dv", manifest()) as writer,
    ):
        step(writer)
    with pytest.raises(ValueError, match='expected no background in a scene of kind "object"'):
        replace(manifest(), background=SceneBackground(5, shadow=False))


def _background(**fields: object) -> Callable[[dict[str, Any]], None]:
    return lambda content: content["background"].update(fields)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda content: content.pop("background"), 'expected a key "background", got none'),
        (lambda content: content.update(kind="object"), 'background: expected no background for kind "object"'),
        (lambda content: content.update(version=1), "kind: expected \"object\" in format version 1, got 'full'"),
        (lambda content: content.update(version=6), "format version 5 or older, got 6; update fourd"),
        (lambda content: content.update(background=[]), "background: expected a JSON object"),
        (lambda content: content["background"].pop("points"), 'background: expected a key "points", got none'),
        (lambda content: content["background"].pop("shadow"), 'background: expected a key "shadow", got none'),
        (_background(points=-1), "background, points: expected a whole number >= 0, got -1"),
        (_background(points=10**12), "background, points: expected a whole number <= 67108864, got 1000"),
        (_background(points=float("nan")), "background, points: expected a whole number, got nan"),
        (_background(points=True), "background, points: expected a whole number, got True"),
        (_background(points=301, shadow=False), "3612 bytes in background/xyz according to the manifest, got 3600"),
        (_background(points=1 << 26), "67108864 bytes in frames/000000/shadow according to the manifest, got 300"),
        (_background(shadow=1), "background, shadow: expected true or false, got 1"),
        (_background(shadow="true"), "background, shadow: expected true or false"),
    ],
)
def test_an_invalid_background_in_the_manifest_is_rejected(
    scene: Path, change: Callable[[dict[str, Any]], None], words: str
) -> None:
    """Catches a field that is used before it is checked, and a background in a format version without backgrounds."""
    with pytest.raises(UserError, match=words) as caught:
        SceneReader(with_manifest(scene, change))
    assert "changed.4dv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_shadows_are_rejected(tmp_path: Path) -> None:
    """Catches a missing shadow member that is ignored."""
    write_full_scene(tmp_path / "plain.4dv", shadow=False)
    with pytest.raises(UserError, match="expected a member frames/000000/shadow, got none"):
        SceneReader(with_manifest(tmp_path / "plain.4dv", _background(shadow=True)))


@pytest.mark.parametrize("name", ["background/rgb", "frames/000001/shadow"])
@pytest.mark.parametrize(("keep", "words"), [(None, "expected a member {}, got none"), (7, r"bytes in {} .*, got 7;")])
def test_missing_and_truncated_members_are_rejected(scene: Path, name: str, keep: int | None, words: str) -> None:
    """Catches a reader that takes array sizes from the file instead of the manifest."""

    def damage(members: dict[str, bytes]) -> None:
        content = members.pop(name)
        if keep is not None:
            members[name] = content[:keep]

    with pytest.raises(UserError, match=words.format(name)):
        SceneReader(rewritten(scene, damage))


@pytest.mark.parametrize(
    ("name", "value"), [("xyz", np.inf), ("radius", -1), ("density", 2), ("sh", np.nan), ("blend_weights", np.nan)]
)
def test_invalid_values_in_the_background_are_rejected_on_reading(scene: Path, name: str, value: float) -> None:
    """Catches NaN values in a background that are accepted because the checksums of the scene are correct."""
    dtype = next(item.dtype for item in ATTRIBUTES if item.name == name)

    def spoil(members: dict[str, bytes]) -> None:
        content = np.frombuffer(members[f"background/{name}"], dtype).copy()
        content[-1] = value
        members[f"background/{name}"] = content.tobytes()

    reader = SceneReader(rewritten(scene, spoil))
    reader.read_dynamic(0)
    for _ in range(2):
        with pytest.raises(UserError, match=f"expected finite numbers in background/{name}, got NaN"):
            reader.read(0)


@pytest.mark.parametrize("name", ["background/sh", "frames/000001/shadow"])
def test_flipped_bytes_are_detected(scene: Path, name: str) -> None:
    """Catches a reader that does not verify the checksums of backgrounds and shadows."""
    with zipfile.ZipFile(scene) as archive:
        at = archive.getinfo(name).header_offset + 30 + len(name)
    content = bytearray(scene.read_bytes())
    content[at] ^= 0xFF
    scene.write_bytes(bytes(content))
    with pytest.raises(UserError, match=f"expected an intact member {name}"):
        SceneReader(scene).read(1)


def test_any_damage_is_a_user_error(scene: Path, rng: np.random.Generator) -> None:
    """Catches unexpected exceptions of zipfile, json and NumPy. The test writes random bytes into the ZIP's central
    directory."""
    content = scene.read_bytes()
    for _ in range(100):
        damaged = bytearray(content)
        for at in rng.integers(len(content) - 6000, len(content), 3):
            damaged[at] = int(rng.integers(0, 256))
        scene.write_bytes(bytes(damaged))
        assert "\n" not in error_message(scene)


def error_message(scene: Path) -> str:
    """Read all frames, and return the error message, or '' if no error occurs."""
    try:
        reader = SceneReader(scene)
        for index in range(reader.manifest.frame_count):
            reader.read(index)
    except UserError as error:
        return str(error)
    return ""


def test_threads_share_one_background(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a background that is read more than once, or that a thread uses before another thread has read it
    completely."""
    reads: Counter[str] = Counter()
    read = zipfile.ZipFile.read

    def counted(self: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
        reads[member.filename] += 1
        return read(self, member)

    alone = [SceneReader(scene).read(index) for index in range(3)]
    monkeypatch.setattr(zipfile.ZipFile, "read", counted)
    reader, start = SceneReader(scene), Barrier(6)

    def read_one(number: int) -> BakedFrame:
        start.wait(10)
        return reader.read(number % 3)

    with ThreadPoolExecutor(6) as pool:
        frames = list(pool.map(read_one, range(6)))
    for number, frame in enumerate(frames):
        assert_same(frame, alone[number % 3])
    assert [reads[f"background/{item.name}"] for item in alone[0].attributes] == [1] * len(alone[0].attributes)


def test_a_closed_reader_releases_its_memory(scene: Path) -> None:
    """Catches a background that stays in memory after the scene is closed, and a closed scene that is reported as
    damaged."""
    reader = SceneReader(scene)
    reader.read_background()
    reader.close()
    with pytest.raises(ValueError, match=r"full\.4dv: expected an open scene, got a closed one"):
        reader.read_background()
    with pytest.raises(ValueError, match="expected an open scene"):
        reader.read(0)


def test_caches_count_the_size_of_combined_frames(tmp_path: Path) -> None:
    """Catches a cache that does not count the memory of the background."""
    write_full_scene(tmp_path / "full.4dv", frames=3, points=200)
    described = SceneReader(tmp_path / "full.4dv").manifest
    room = room_frame(BACKGROUND_POINTS, VIEWS, seed=100)
    assert described.background_nbytes == room.nbytes
    assert described.frame_nbytes(1) == random_frame(201, VIEWS, seed=0).nbytes + room.nbytes
    two = described.frame_nbytes(0) + described.frame_nbytes(1) + described.background_nbytes
    for fits_two, cache_bytes in ((True, two), (False, two - 1)):
        with open_scene(tmp_path / "full.4dv", cache_bytes=cache_bytes) as opened:
            first = opened.frame(0)
            assert first.nbytes == described.frame_nbytes(0)
            opened.frame(1)
            assert (opened.frame(0) is first) == fits_two


def test_a_picture_shows_frame_and_background(scene: Path) -> None:
    """Catches rendering without the background points, and walls drawn in front of the ball."""
    with open_scene(scene) as opened:
        camera = opened.manifest.other_cameras[0].resize(64, 64)
        picture = opened.render(camera, 0)
        assert (picture.alpha > 0.5).mean() > 0.9, "the walls cover the picture"
        assert picture.depth[28:36, 28:36].min() < 6, "the ball is in front of them"
        assert picture.depth[:6].min() > 10
