"""Tests of uploads: objects are replaced atomically, and an error of the store is one line that names the URL."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import pytest

from fourd.base.errors import UserError
from fourd.base.progress import Track
from fourd.base.storage import StorageUrl, check_writable, fetch, local_output, open_object, upload, upload_changed
from tests.storage.s3_server import Bucket, S3Server, unfinished_uploads

Item = TypeVar("Item")
MEGABYTE = 1 << 20

STOP_AFTER_THE_SECOND_PART = """
import sys, time
from pathlib import Path
from fourd.base.storage import StorageUrl, upload
import fourd.base.storage.uploading
fourd.base.storage.uploading.PART_BYTES = 5 << 20

def track(items, count, what):
    for item in items:
        if item == 2:
            print("two parts are sent", flush=True)
            time.sleep(600)
        yield item

upload(Path(sys.argv[1]), StorageUrl(sys.argv[2]), track)
"""


def big_file(folder: Path, size: int = 18 * MEGABYTE) -> Path:
    path = folder / "new.4dv"
    path.write_bytes(bytes(range(256)) * (size // 256))
    return path


def test_a_kill_in_the_middle_of_an_upload_leaves_the_old_object(bucket: Bucket, tmp_path: Path) -> None:
    """Catches parts that become visible before the upload is complete, and an old object that is removed first."""
    key = f"{bucket.name}/scenes/scene.4dv"
    bucket.files.pipe_file(key, b"the old scene")
    words = [sys.executable, "-c", STOP_AFTER_THE_SECOND_PART, str(big_file(tmp_path)), f"s3://{key}"]
    child = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env={**os.environ})
    assert child.stdout is not None
    assert child.stdout.readline() == "two parts are sent\n"
    assert unfinished_uploads(bucket.files, bucket.name) == ["scenes/scene.4dv"]
    child.send_signal(signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    assert bucket.files.find(f"{bucket.name}/") == [key]
    assert bucket.files.cat_file(key) == b"the old scene"
    upload(tmp_path / "new.4dv", StorageUrl(f"s3://{key}"))
    assert bucket.files.cat_file(key) == (tmp_path / "new.4dv").read_bytes()


@pytest.mark.parametrize("size", [0, 1, 5 * MEGABYTE, 12 * MEGABYTE + 1])
def test_uploads_have_all_bytes(bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    """Catches a failed upload of an empty file, which cannot be a multipart upload. Also catches an uploaded object
    whose last part is missing.
    """
    monkeypatch.setattr("fourd.base.storage.uploading.PART_BYTES", 5 * MEGABYTE)
    path = tmp_path / "scene.4dv"
    path.write_bytes(os.urandom(size))
    upload(path, StorageUrl(f"{bucket.url}/scene.4dv"))
    assert bucket.files.cat_file(f"{bucket.name}/scene.4dv") == path.read_bytes()
    assert unfinished_uploads(bucket.files, bucket.name) == []


def test_a_failed_upload_leaves_no_parts(bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches parts that stay in the bucket after Ctrl-C or an error. Such parts cost money."""
    monkeypatch.setattr("fourd.base.storage.uploading.PART_BYTES", 5 * MEGABYTE)
    bucket.files.pipe_file(f"{bucket.name}/scene.4dv", b"old")

    def interrupt(items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
        yield next(iter(items))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        upload(big_file(tmp_path), StorageUrl(f"{bucket.url}/scene.4dv"), interrupt)
    assert bucket.files.cat_file(f"{bucket.name}/scene.4dv") == b"old"
    assert unfinished_uploads(bucket.files, bucket.name) == []


def test_an_output_is_uploaded_only_if_the_work_succeeds(bucket: Bucket) -> None:
    """Catches an upload of an incomplete file, and a message that names a temporary file that has
    already been removed.
    """
    url = StorageUrl(f"{bucket.url}/scene.4dv")
    with pytest.raises(UserError) as caught, local_output(url) as path:
        path.write_bytes(b"half")
        raise UserError(f"{path}: expected more frames, got none")
    assert str(caught.value) == f"{url}: expected more frames, got none"
    assert not path.exists()
    assert bucket.files.find(f"{bucket.name}/") == []
    with local_output(url) as path:
        path.write_bytes(b"whole")
    assert not path.exists()
    assert bucket.files.cat_file(f"{bucket.name}/scene.4dv") == b"whole"


def test_a_lost_connection_leaves_the_old_object(
    bucket: Bucket, new_connections: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a traceback and a lost object if the store stops during an upload."""
    monkeypatch.setattr("fourd.base.storage.uploading.PART_BYTES", 5 * MEGABYTE)
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    other = S3Server.start()
    monkeypatch.setenv("AWS_ENDPOINT_URL", other.endpoint)
    bucket.files.pipe_file(f"{bucket.name}/scene.4dv", b"old")
    url = StorageUrl(f"{bucket.url}/scene.4dv")

    def stop_the_server(items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
        for index, item in enumerate(items):
            if index == 2:
                other.server.stop()
            yield item

    with pytest.raises(UserError) as caught:
        upload(big_file(tmp_path), url, stop_the_server)
    assert str(caught.value).startswith(f"{url}: expected a store that answers, got '")
    assert str(caught.value).endswith("'; check the network, and AWS_ENDPOINT_URL if the store is not Amazon's")
    # The servers of this process share their objects.
    assert bucket.files.cat_file(f"{bucket.name}/scene.4dv") == b"old"


def test_a_store_that_refuses_is_named(bucket: Bucket, s3_server: S3Server, tmp_path: Path) -> None:
    """Catches a traceback for credentials without permissions."""
    url = StorageUrl(f"{bucket.url}/scene.4dv")
    with s3_server.refusing():
        for use in (lambda: check_writable(url), lambda: fetch(url, tmp_path), lambda: open_object(url)):
            with pytest.raises(UserError) as caught:
                use()
            assert str(caught.value).startswith(f"{url}: expected access to the bucket, got '")
            assert str(caught.value).endswith("check the credentials and their permissions to list, read and write")
    check_writable(url)


def test_a_refusal_comes_before_the_work(bucket: Bucket) -> None:
    """Catches a missing bucket that is reported only after hours of training."""
    with pytest.raises(UserError) as caught, local_output(StorageUrl("s3://no-such-bucket/scene.4dv")):
        pytest.fail("the block must not start")
    assert str(caught.value) == (
        "s3://no-such-bucket/scene.4dv: expected an existing bucket and object, got 'The specified bucket does not "
        "exist'; check the bucket and the name"
    )
    bucket.files.pipe_file(f"{bucket.name}/scene.4dv", b"old")
    check_writable(StorageUrl(f"{bucket.url}/scene.4dv"))
    assert bucket.files.cat_file(f"{bucket.name}/scene.4dv") == b"old"
    assert unfinished_uploads(bucket.files, bucket.name) == []


def test_an_unchanged_scene_is_not_uploaded_again(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a scene that is uploaded although the store has it already, and a scene that is not uploaded although its
    object was changed or removed."""
    path, url, record = tmp_path / "scene.4dv", StorageUrl(f"{bucket.url}/scene.4dv"), tmp_path / "uploaded.json"
    key = f"{bucket.name}/scene.4dv"
    path.write_bytes(b"first")
    upload_changed(path, url, record)
    uploads: list[StorageUrl] = []

    def count(path: Path, url: StorageUrl, track: Track) -> None:
        uploads.append(url)
        upload(path, url, track)

    monkeypatch.setattr("fourd.base.storage.uploading.upload", count)
    upload_changed(path, url, record)
    assert not uploads
    bucket.files.pipe_file(key, b"other")
    upload_changed(path, url, record)
    assert bucket.files.cat_file(key) == b"first"
    bucket.files.rm_file(key)
    upload_changed(path, url, record)
    path.write_bytes(b"second")
    upload_changed(path, url, record)
    assert bucket.files.cat_file(key) == b"second"
    record.write_text('["half')
    upload_changed(path, url, record)
    assert len(uploads) == 4
