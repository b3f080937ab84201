"""The `.4dv` file: round trips, and invalid or damaged files, which must give a one-line error."""

from __future__ import annotations

import errno
import json
import os
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.scene import BakedFrame, SceneManifest, SceneReader, SceneWriter
from tests.baking.scenes import manifest, random_frame, write_scene

VERSION_1 = Path(__file__).with_name("data") / "version1.4dv"
Rewrite = Callable[[dict[str, bytes]], None]


def rewritten(path: Path, change: Rewrite, compression: int = zipfile.ZIP_STORED) -> Path:
    """Copy a scene with its members changed by ``change``."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    out = path.with_name("changed.4dv")
    with zipfile.ZipFile(out, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out


def with_manifest(path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """Copy a scene with a changed manifest. NaN is written as the word NaN, which is the default of Python's json
    module."""

    def rewrite(members: dict[str, bytes]) -> None:
        content = json.loads(members["manifest.json"])
        change(content)
        members["manifest.json"] = json.dumps(content).encode()

    return rewritten(path, rewrite)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.4dv"
    write_scene(path)
    return path


def test_frames_and_manifest_round_trip(tmp_path: Path) -> None:
    """Catches swapped attributes, wrong byte order and swapped frames."""
    path = tmp_path / "new folder" / "scene.4dv"
    written = write_scene(path)
    reader = SceneReader(path)
    for index, frame in enumerate(written):
        again = reader.read(index)
        for attribute in frame.attributes:
            np.testing.assert_array_equal(getattr(again, attribute.name), getattr(frame, attribute.name))
    expected, got = manifest(), reader.manifest
    assert got.points == (200, 201, 202)
    assert (got.names, got.frame_numbers) == (expected.names, expected.frame_numbers)
    assert (got.fps, got.focus, got.bounds, got.kind) == (24.0, expected.focus, expected.bounds, "object")
    assert got.fade_views is expected.fade_views is True
    for before, after in zip(expected.cameras, got.cameras, strict=True):
        np.testing.assert_array_equal(before.intrinsics, after.intrinsics)
        np.testing.assert_array_equal(before.rotation, after.rotation)
        np.testing.assert_array_equal(before.translation, after.translation)


def test_the_same_scene_gives_the_same_bytes(tmp_path: Path) -> None:
    """Catches timestamps in the file, and an order of members that depends on hashes. Equal scenes must give equal
    bytes."""
    write_scene(tmp_path / "a.4dv")
    write_scene(tmp_path / "b.4dv")
    assert (tmp_path / "a.4dv").read_bytes() == (tmp_path / "b.4dv").read_bytes()


def plain_frame(points: int, start: int) -> BakedFrame:
    """Return numbers that are the same in every version of NumPy."""

    def count_up(shape: tuple[int, ...], dtype: type, step: float) -> NDArray[Any]:
        return (start + step * np.arange(np.prod(shape))).reshape(shape).astype(dtype)

    return BakedFrame(
        xyz=count_up((points, 3), np.float32, 0.25),
        radius=count_up((points,), np.float16, 0.125),
        density=np.linspace(0, 1, points).astype(np.float16),
        sh=count_up((points, 3, 16), np.float16, -0.5),
        blend_weights=count_up((points, 2), np.float16, 2),
        rgb=count_up((points, 2, 3), np.uint8, 7),
    )


def plain_manifest() -> SceneManifest:
    """Write a scene of two frames, two source views and one other camera."""
    intrinsics = np.array([[40.0, 0, 16], [0, 41, 12], [0, 0, 1]])
    rotated = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    first, second, third = (
        Camera(intrinsics, rotation, np.array([0.5, 0, 2]), 32, 24) for rotation in (np.eye(3), rotated, np.eye(3))
    )
    return SceneManifest(
        source_names=("a", "b"),
        source_cameras=(first, second),
        focus=(0.0, 0.5, 0.0),
        bounds=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        frame_numbers=(7, 9),
        other_names=("c",),
        other_cameras=(third,),
        fps=25.0,
        producer="tests",
    )


def test_a_file_of_version_1_is_read_and_still_written(tmp_path: Path) -> None:
    """Catches a format change that breaks existing scenes or older programs.

    The folder data/ contains a scene in the original format.
    """
    frames = [plain_frame(3, start=1), plain_frame(2, start=5)]
    reader = SceneReader(VERSION_1)
    assert (reader.manifest.version, reader.manifest.kind, reader.manifest.points) == (1, "object", (3, 2))
    assert reader.manifest.fade_views is False
    for index, frame in enumerate(frames):
        for attribute in frame.attributes:
            np.testing.assert_array_equal(getattr(reader.read(index), attribute.name), getattr(frame, attribute.name))
    with SceneWriter(tmp_path / "again.4dv", plain_manifest()) as writer:
        for index, frame in enumerate(frames):
            writer.add_frame(index, frame)
    with zipfile.ZipFile(VERSION_1) as old, zipfile.ZipFile(tmp_path / "again.4dv") as new:
        assert new.namelist() == old.namelist()
        for name in old.namelist():
            assert new.read(name) == old.read(name), name
            assert new.getinfo(name).header_offset == old.getinfo(name).header_offset


def test_members_are_raw_arrays(scene: Path) -> None:
    """Catches compressed members and extra headers. An HTTP range request for a member must return the raw array."""
    frame = SceneReader(scene).read(1)
    with zipfile.ZipFile(scene) as archive:
        info = archive.getinfo("frames/000001/xyz")
    content = scene.read_bytes()
    name, extra = struct.unpack("<HH", content[info.header_offset + 26 : info.header_offset + 30])
    begin = info.header_offset + 30 + name + extra
    assert content[begin : begin + info.file_size] == frame.xyz.astype("<f4").tobytes()


def test_a_frame_may_be_empty(tmp_path: Path) -> None:
    """Catches a frame without points, from an empty visual hull, that cannot be written or read."""
    path = tmp_path / "empty.4dv"
    with SceneWriter(path, manifest(views=0, frames=1)) as writer:
        writer.add_frame(0, random_frame(0, 0, seed=0))
    assert SceneReader(path).read(0).point_count == 0


def test_an_exception_keeps_the_old_file_and_leaves_no_other(scene: Path) -> None:
    """Catches a writer that destroys an existing scene if it fails."""
    before = scene.read_bytes()
    with pytest.raises(KeyboardInterrupt), SceneWriter(scene, manifest()) as writer:
        writer.add_frame(0, random_frame(5, 6, seed=0))
        raise KeyboardInterrupt
    assert scene.read_bytes() == before
    assert os.listdir(scene.parent) == [scene.name]


def test_too_few_frames_write_no_file(tmp_path: Path) -> None:
    """Catches a scene with fewer frames than its manifest declares."""
    path = tmp_path / "scene.4dv"
    with pytest.raises(ValueError, match="expected 3 frames, got 1"), SceneWriter(path, manifest()) as writer:
        writer.add_frame(0, random_frame(5, 6, seed=0))
    assert os.listdir(tmp_path) == []


def test_a_full_disk_is_a_user_error(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a traceback or a partial scene when the disk is full."""
    before = scene.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(UserError, match="the disk is full; free some space"), SceneWriter(scene, manifest()) as writer:
        monkeypatch.setattr(zipfile.ZipFile, "writestr", full)
        writer.add_frame(0, random_frame(5, 6, seed=0))
    assert scene.read_bytes() == before
    assert os.listdir(scene.parent) == [scene.name]


@pytest.mark.parametrize("name", ["xyz", "radius", "density", "sh", "blend_weights"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_the_writer_rejects_invalid_values(tmp_path: Path, name: str, value: float) -> None:
    """Catches a writer that accepts NaN."""
    if value == -1 and name in ("xyz", "sh"):
        pytest.skip("these may be negative")
    frame = random_frame(5, 6, seed=0)
    getattr(frame, name).flat[3] = value
    with pytest.raises(ValueError, match=f"frame 0, {name}"), SceneWriter(tmp_path / "a.4dv", manifest()) as writer:
        writer.add_frame(0, frame)


def test_frames_are_added_in_order(tmp_path: Path) -> None:
    """Catches frames that are stored under a wrong index."""
    with (
        pytest.raises(ValueError, match="expected frame 0 of 3 next, got 1"),
        SceneWriter(tmp_path / "a.4dv", manifest()) as writer,
    ):
        writer.add_frame(1, random_frame(5, 6, seed=0))


@pytest.mark.parametrize("kept", [0, 1, 100, 0.5, -1])
def test_a_truncated_scene_is_rejected_on_opening(scene: Path, kept: float) -> None:
    """Catches a partial download that opens without an error or that causes a traceback."""
    content = scene.read_bytes()
    scene.write_bytes(content[: int(kept * len(content)) if kept == 0.5 else int(kept)])
    with pytest.raises(UserError, match=r"scene\.4dv: expected a complete \.4dv scene.*copy or export it again"):
        SceneReader(scene)


def test_flipped_bytes_are_detected(scene: Path) -> None:
    """Catches a reader that skips the checksums."""
    content = bytearray(scene.read_bytes())
    content[200] ^= 0xFF
    scene.write_bytes(bytes(content))
    with pytest.raises(UserError, match="expected an intact member frames/000000/xyz"):
        SceneReader(scene).read(0)


def test_any_damage_is_a_user_error(scene: Path, rng: np.random.Generator) -> None:
    """Catches unexpected exceptions of zipfile, json and struct. The test writes random bytes into the last 4000 bytes
    of the file."""
    content = scene.read_bytes()
    tail = len(content) - 4000
    for _ in range(300):
        damaged = bytearray(content)
        for at in rng.integers(tail, len(content), 3):
            damaged[at] = int(rng.integers(0, 256))
        scene.write_bytes(bytes(damaged))
        assert "\n" not in _error_message(scene)


def _error_message(scene: Path) -> str:
    try:
        reader = SceneReader(scene)
        for index in range(reader.manifest.frame_count):
            reader.read(index)
    except UserError as error:
        return str(error)
    return ""


def test_other_files_and_folders_are_rejected(tmp_path: Path) -> None:
    """Catches a traceback for a folder, a missing file or a ZIP that is not a scene."""
    with pytest.raises(UserError, match="got a folder"):
        SceneReader(tmp_path)
    with pytest.raises(UserError, match="got a path that does not exist"):
        SceneReader(tmp_path / "none.4dv")
    other = tmp_path / "other.zip"
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("hello.txt", "hello")
    with pytest.raises(UserError, match=r"expected a scene that contains manifest\.json, got a ZIP without it"):
        SceneReader(other)


def test_a_newer_version_asks_for_an_update(scene: Path) -> None:
    """Catches a reader that reads a file of a newer format version as if it had the current version."""
    path = with_manifest(scene, lambda content: content.update(version=6))
    with pytest.raises(UserError, match="format version 5 or older, got 6; update fourd"):
        SceneReader(path)


def _set(*keys: str | int, to: object) -> Callable[[dict[str, Any]], None]:
    def change(content: Any) -> None:
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = to

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_set("format", to="other"), 'expected format "fourd-scene", got "other"'),
        (_set("version", to="1"), "version: expected a whole number"),
        (_set("version", to=True), "version: expected a whole number"),
        (_set("fps", to=float("nan")), "fps: expected a number >= 0.001, got nan"),
        (_set("fps", to=0), "fps: expected a number >= 0.001, got 0"),
        (_set("fade_views", to=1), "fade_views: expected true or false, got 1"),
        (_set("layers", to=0), "layers: expected a whole number >= 1, got 0"),
        (_set("layers", to=10**400), "layers: expected a whole number <= 64, got 1000"),
        (_set("kind", to="thing"), "kind: expected a value that is possible here, got 'thing'"),
        (_set("focus", to=[0, 0]), r"focus: expected a list of length 3, got \[0, 0\]"),
        (_set("focus", to=[0, 0, float("inf")]), r"focus\[2\]: expected a number < 1e\+30, got inf"),
        (_set("bounds", "lower", to=[5, 5, 5]), "bounds: expected lower below upper"),
        (_set("bounds", to=7), "bounds: expected a JSON object, got 7"),
        (_set("frames", to={}), "frames: expected a list"),
        (_set("frames", 0, "points", to=-1), r"frames\[0\], points: expected a whole number >= 0, got -1"),
        (_set("frames", 0, "points", to=10**12), r"frames\[0\], points: expected a whole number <= 6"),
        (_set("frames", 0, "points", to=201), "2412 bytes in frames/000000/xyz according to the manifest, got 2400"),
        (_set("attributes", "xyz", "dtype", to="<f8"), 'xyz, dtype: expected "<f4"'),
        (_set("attributes", "sh", "shape", to=["points", 3, 9]), "sh, shape: expected"),
        (_set("source_views", 1, "name", to="00"), "expected every name once"),
        (_set("source_views", 1, "name", to="a\nb"), "name: expected printable text"),
        (
            _set("source_views", 0, "rotation", to=[[2, 0, 0], [0, 1, 0], [0, 0, 1]]),
            "rotation: expected an orthonormal",
        ),
        (
            _set("source_views", 0, "rotation", 0, 0, to=float("nan")),
            r"rotation\[0\]\[0\]: expected a number .* got nan",
        ),
        (_set("source_views", 0, "intrinsics", 0, 0, to=-5), "intrinsics: expected positive focal"),
        (_set("source_views", 0, "translation", to=["a", 0, 0]), r"translation\[0\]: expected a number, got 'a'"),
        (lambda content: content.pop("focus"), 'expected a key "focus", got none'),
        (lambda content: content["source_views"].pop(), "bytes in frames/000000/blend_weights"),
    ],
)
def test_an_invalid_manifest_is_rejected(scene: Path, change: Callable[[dict[str, Any]], None], words: str) -> None:
    """Catches a manifest field that is used before it is checked."""
    with pytest.raises(UserError, match=words) as caught:
        SceneReader(with_manifest(scene, change))
    assert "changed.4dv" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b"\xff\xfe", b"[" * 100_000])
def test_a_manifest_that_is_not_json_is_rejected(scene: Path, text: bytes) -> None:
    """Catches uncaught decoding errors, including errors from JSON that is nested deeper than the recursion limit."""
    path = rewritten(scene, lambda members: members.update({"manifest.json": text}))
    with pytest.raises(UserError, match=r"manifest\.json: expected"):
        SceneReader(path)


@pytest.mark.parametrize("name", ["../evil", "/etc/passwd", "a\\..\\b", "frames/../../x", "c:x"])
def test_member_names_outside_the_archive_are_rejected(scene: Path, name: str) -> None:
    """Catches member names that would unpack to paths outside the target folder."""
    path = rewritten(scene, lambda members: members.update({name: b"x"}))
    with pytest.raises(UserError, match="expected member names inside the archive"):
        SceneReader(path)


def test_a_missing_member_is_rejected_on_opening(scene: Path) -> None:
    """Catches a missing member that is detected only when its frame is read."""

    def drop(members: dict[str, bytes]) -> None:
        del members["frames/000002/rgb"]

    with pytest.raises(UserError, match="expected a member frames/000002/rgb, got none"):
        SceneReader(rewritten(scene, drop))


def test_compressed_members_are_rejected(scene: Path) -> None:
    """Catches a reader that accepts ZIP bombs, which are small files that unpack to gigabytes."""
    with pytest.raises(UserError, match=r"the compressed member .*; use zip -0"):
        SceneReader(rewritten(scene, lambda members: None, zipfile.ZIP_DEFLATED))


def test_invalid_values_in_a_frame_are_rejected_on_reading(scene: Path) -> None:
    """Catches NaN values that are accepted because the checksums of the scene are correct."""

    def spoil(members: dict[str, bytes]) -> None:
        content = bytearray(members["frames/000001/blend_weights"])
        content[0:2] = np.float16(np.nan).tobytes()
        members["frames/000001/blend_weights"] = bytes(content)

    reader = SceneReader(rewritten(scene, spoil))
    reader.read(0)
    with pytest.raises(UserError, match="expected finite numbers in frames/000001/blend_weights"):
        reader.read(1)


def test_memory_does_not_grow_with_the_number_of_frames(tmp_path: Path) -> None:
    """Catches a writer that keeps frames in memory. 40 frames must need no more memory than 4 frames."""

    def peak(frames: int) -> int:
        frame = random_frame(2000, 6, seed=0)
        tracemalloc.start()
        with SceneWriter(tmp_path / "scene.4dv", manifest(frames=frames)) as writer:
            for index in range(frames):
                writer.add_frame(index, frame)
        reader = SceneReader(tmp_path / "scene.4dv")
        for index in range(frames):
            reader.read(index)
        reader.close()
        _, peak_bytes = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return peak_bytes

    assert peak(40) < peak(4) + random_frame(2000, 6, seed=0).nbytes
