"""Tests of scenes that are read from a store by ranges."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.storage import StorageUrl
from fourd.base.storage.ranges import READ_AHEAD_BYTES
from fourd.scene import SceneReader, open_scene
from fourd.scene.playable import open_playable
from tests.baking.scenes import write_scene
from tests.storage.s3_server import Bucket


@pytest.fixture
def read_bytes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the ranges that are read from S3."""
    s3fs = pytest.importorskip("s3fs")
    fetch, sizes = s3fs.S3File._fetch_range, []

    def fetch_and_count(stream: Any, start: int, end: int) -> bytes:
        content: bytes = fetch(stream, start, end)
        sizes.append(len(content))
        return content

    monkeypatch.setattr(s3fs.S3File, "_fetch_range", fetch_and_count)
    return sizes


@pytest.fixture
def memory_store() -> Iterator[Any]:
    """fsspec's store in the memory of this process. Like most stores, this store does not support conditional reads."""
    store = pytest.importorskip("fsspec").filesystem("memory")
    store.mkdir("/bucket")
    yield store
    store.rm("/bucket", recursive=True)


def test_a_frame_is_read_without_the_rest_of_the_scene(bucket: Bucket, tmp_path: Path, read_bytes: list[int]) -> None:
    """Catches a player that downloads the whole scene, or reads one byte range for each few bytes."""
    path = tmp_path / "scene.4dv"
    write_scene(path, frames=4, points=20_000)
    bucket.files.put_file(str(path), f"{bucket.name}/scene.4dv")
    local, size = SceneReader(path), path.stat().st_size
    remote = SceneReader(f"{bucket.url}/scene.4dv")
    assert remote.manifest.points == local.manifest.points
    assert remote.size == size
    assert sum(read_bytes) <= 3 * READ_AHEAD_BYTES
    read_bytes.clear()
    arrays = remote.read(2).arrays
    for name, array in local.read(2).arrays.items():
        np.testing.assert_array_equal(arrays[name], array)
    assert sum(read_bytes) < size / 4 + 2 * READ_AHEAD_BYTES
    assert len(read_bytes) <= 2 * len(arrays)
    remote.close()
    with pytest.raises(ValueError, match=r"expected an open scene, got a closed one"):
        remote.read(0)


def test_scenes_in_a_store_render_like_local_scenes(bucket: Bucket, tmp_path: Path) -> None:
    """Catches a public function that uses a URL as a path."""
    path = tmp_path / "scene.4dv"
    write_scene(path)
    bucket.files.put_file(str(path), f"{bucket.name}/scene.4dv")
    url = f"{bucket.url}/scene.4dv"
    with open_scene(path) as local, open_scene(url) as remote:
        assert str(remote.path) == url
        camera = local.manifest.cameras[0]
        np.testing.assert_array_equal(remote.render(camera, 1).rgb, local.render(camera, 1).rgb)
    assert open_playable(StorageUrl(url)).frame_numbers == (10, 11, 12)


def test_a_scene_that_is_replaced_while_it_plays_is_an_error(bucket: Bucket, tmp_path: Path) -> None:
    """Catches members of a new scene that are read with the index of the old scene."""
    path = tmp_path / "scene.4dv"
    write_scene(path, points=20_000)
    bucket.files.put_file(str(path), f"{bucket.name}/scene.4dv")
    url = f"{bucket.url}/scene.4dv"
    reader = SceneReader(url)
    write_scene(path, points=30_000)
    bucket.files.put_file(str(path), f"{bucket.name}/scene.4dv")
    with pytest.raises(UserError, match=f"^{url}: expected an object that stays the same while it is read, got"):
        reader.read(1)


def test_stores_without_conditional_reads_are_asked_for_the_version(memory_store: Any, tmp_path: Path) -> None:
    """Catches a check for changed objects that works only with S3."""
    path = tmp_path / "scene.4dv"
    write_scene(path, points=20_000)
    memory_store.pipe_file("/bucket/scene.4dv", path.read_bytes())
    reader = SceneReader("memory://bucket/scene.4dv")
    assert reader.read(1).point_count == 20_001
    write_scene(path, points=30_000)
    memory_store.pipe_file("/bucket/scene.4dv", path.read_bytes())
    with pytest.raises(UserError, match=r"^memory://bucket/scene.4dv: expected an object that stays the same"):
        reader.read(2)


def test_damaged_and_missing_scenes_are_named_by_their_url(bucket: Bucket, tmp_path: Path) -> None:
    """Catches a message without the name of the file, and a folder that is opened as a scene."""
    path = tmp_path / "scene.4dv"
    write_scene(path)
    bucket.files.pipe_file(f"{bucket.name}/half.4dv", path.read_bytes()[:-100])
    bucket.files.pipe_file(f"{bucket.name}/empty.4dv", b"")
    expected = "expected a complete .4dv scene"
    for name, message in (("half.4dv", expected), ("empty.4dv", expected), ("none.4dv", "expected an existing bucket")):
        with pytest.raises(UserError) as caught:
            SceneReader(f"{bucket.url}/{name}")
        assert str(caught.value).startswith(f"{bucket.url}/{name}: {message}")
