"""Tests of gs:// URLs on a local emulator of Google Cloud Storage. The tests need gcsfs and gcp-storage-emulator. The
extra dev does not contain these packages, because the releases of gcsfs and s3fs need different versions of fsspec.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

import pytest

from fourd.base.errors import UserError
from fourd.base.storage import StorageUrl, check_writable, fetch, find_objects, open_object, upload
from fourd.pipeline.stage import Context
from fourd.pipeline.stored.cache import CACHE_VARIABLE, Cache, cache_folder
from fourd.pipeline.stored.unit import UnitFiles, unit_stage
from fourd.pipeline.stored.work_store import WorkStore
from tests.pipeline.test_stage import copy_stage

MEGABYTE = 1 << 20


@pytest.fixture(scope="module")
def store() -> Iterator[Any]:
    """Start an emulator with the bucket "bucket", and set the environment variables with which gcsfs uses this
    emulator. Yields the storage of the emulator.
    """
    # With this variable, gcsfs does not request the kind of the bucket by gRPC. The emulator does not answer gRPC
    # requests.
    patch = pytest.MonkeyPatch()
    patch.setenv("GCSFS_EXPERIMENTAL_ZB_HNS_SUPPORT", "false")
    gcsfs = pytest.importorskip("gcsfs", reason="needs gcsfs")
    server = pytest.importorskip("gcp_storage_emulator.server", reason="needs gcp-storage-emulator")
    import fsspec

    # The emulator cannot cancel uploads.
    cancel = {"DELETE": lambda request, response, *_: setattr(response, "status", HTTPStatus.NO_CONTENT)}
    handlers = [(regex, {**methods, **cancel} if "upload" in regex else methods) for regex, methods in server.HANDLERS]
    patch.setattr(server, "HANDLERS", tuple(handlers))
    started = server.create_server("127.0.0.1", 0, in_memory=True, default_bucket="bucket")
    started.start()
    host, port = started._api._httpd.server_address
    patch.setenv("STORAGE_EMULATOR_HOST", f"http://{host}:{port}")
    patch.setitem(fsspec.config.conf, "gs", {"token": "anon"})
    gcsfs.GCSFileSystem.clear_instance_cache()
    yield started
    started.stop()
    gcsfs.GCSFileSystem.clear_instance_cache()
    patch.undo()


def test_objects_are_written_and_read(store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches parts with a size that Google Cloud Storage refuses, and lost bytes of small, empty and large files. Also
    catches an object's version that gcsfs reports under another name.
    """
    monkeypatch.setattr("fourd.base.storage.uploading.PART_BYTES", MEGABYTE)
    contents = {"empty": b"", "small": b"text", "large": os.urandom(3 * MEGABYTE + 5)}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
        url = StorageUrl(f"gs://bucket/folder/{name}")
        check_writable(url)
        upload(tmp_path / name, url)
    found = {item.key: item for item in find_objects(StorageUrl("gs://bucket/folder"))}
    assert {key: item.size for key, item in found.items()} == {key: len(value) for key, value in contents.items()}
    assert all(item.seconds is not None and item.version for item in found.values())
    copy = fetch(StorageUrl("gs://bucket/folder"), tmp_path / "copy")
    assert {path.name: path.read_bytes() for path in copy.iterdir()} == contents
    with open_object(StorageUrl("gs://bucket/folder/large")) as stream:
        stream.seek(2 * MEGABYTE)
        assert stream.read(10) == contents["large"][2 * MEGABYTE : 2 * MEGABYTE + 10]


def test_a_replaced_object_is_not_mixed(store: Any, tmp_path: Path) -> None:
    """Catches a reader that gets bytes of two versions."""
    path, url = tmp_path / "scene", StorageUrl("gs://bucket/replaced")
    path.write_bytes(b"a" * MEGABYTE)
    upload(path, url)
    with open_object(url) as stream:
        assert stream.read(4) == b"aaaa"
        path.write_bytes(b"b" * MEGABYTE)
        upload(path, url)
        stream.seek(700_000)
        with pytest.raises(UserError, match=r"expected an object that stays the same while it is read"):
            stream.read(4)


def test_a_missing_bucket_is_one_line(store: Any) -> None:
    """Catches a traceback of gcsfs."""
    with pytest.raises(UserError, match=r"^gs://no-such-bucket/a: expected") as caught:
        check_writable(StorageUrl("gs://no-such-bucket/a"))
    assert "\n" not in str(caught.value)


def test_results_are_shared(store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches results that another machine cannot read, and objects of an earlier execution that stay."""
    work = WorkStore(StorageUrl("gs://bucket/work"))
    assert work.open() == {}
    (tmp_path / "source").write_text("text")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "one"))
    root = cache_folder(work.url)
    stage = copy_stage(tmp_path / "source", root / "a")
    for key in ("first", "second"):
        unit_stage(UnitFiles(stage, root, work, tmp_path, ()), key).run(Context())
    found = work.open()
    assert {name: manifest.key for name, manifest in found.items()} == {"a": "second"}
    assert len(find_objects(work.url)) == 3
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "two"))
    Cache(cache_folder(work.url)).copy(work, [found["a"]], Context().track)
    assert (cache_folder(work.url) / "a" / "copy").read_text() == "text"
    assert (cache_folder(work.url) / "a" / "copy").stat().st_mtime_ns == (root / "a" / "copy").stat().st_mtime_ns
    work.remove(found["a"])
    assert [item.key for item in find_objects(work.url)] == ["work.json"]
