"""Tests of copies from a store. A copy must be complete, have the content of one version, and be resumable. All files
of a copy must be inside the folder of the copy.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import pytest

from fourd.base.errors import UserError
from fourd.base.storage import StorageUrl, fetch, local_copy
from tests.storage.s3_server import Bucket

Item = TypeVar("Item")


def put(bucket: Bucket, **contents: bytes) -> StorageUrl:
    """Write objects into the folder videos/ of the bucket. Two underscores in a name are replaced by a slash."""
    for name, content in contents.items():
        bucket.files.pipe_file(f"{bucket.name}/videos/{name.replace('__', '/')}", content)
    return StorageUrl(f"{bucket.url}/videos")


def copied(parent: Path) -> dict[str, bytes]:
    """Contents of the copied files by name."""
    folder = parent / "videos"
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_second_copy_reads_only_what_changed(bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches outdated copies of changed and of removed objects. Also catches a removal of the files that fourd has
    written into the copy.
    """
    url = put(bucket, a=b"a" * 100, deep__b=b"b", old=b"old")
    bucket.files.pipe_file(f"{bucket.name}/videos/empty/", b"")  # marker of an empty folder
    assert fetch(url, tmp_path) == tmp_path / "videos"
    assert copied(tmp_path) == {"a": b"a" * 100, "deep/b": b"b", "old": b"old"}
    (tmp_path / "videos/.fourd").mkdir()
    (tmp_path / "videos/.fourd/matte").write_bytes(b"matte")
    put(bucket, a=b"A" * 100, c=b"c")
    bucket.files.rm_file(f"{bucket.name}/videos/old")
    read: list[str] = []

    def track(items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
        for item in items:
            read.append(getattr(item, "key", ""))
            yield item

    fetch(url, tmp_path, track)
    assert sorted(read) == ["a", "c"]
    assert copied(tmp_path) == {"a": b"A" * 100, "deep/b": b"b", "c": b"c", ".fourd/matte": b"matte"}


def test_an_interrupted_copy_continues(bucket: Bucket, tmp_path: Path) -> None:
    """Catches an interrupted copy that is repeated from the start, and an incomplete line in the record that makes the
    next copy fail.
    """
    url = put(bucket, a=b"a", b=b"b", c=b"c")
    read: list[str] = []

    def interrupt(items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
        for item in items:
            yield item
            read.append(getattr(item, "key", ""))
            if len(read) == 2:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fetch(url, tmp_path, interrupt)
    with (tmp_path / ".fetched.jsonl").open("a") as record:
        record.write('["c", 1')
    fetch(url, tmp_path, interrupt)
    assert sorted(read) == ["a", "b", "c"]
    assert copied(tmp_path) == {"a": b"a", "b": b"b", "c": b"c"}


def test_the_copy_of_another_url_is_replaced(bucket: Bucket, tmp_path: Path) -> None:
    """Catches a copy with files of two sources that have the same name."""
    fetch(put(bucket, a=b"a"), tmp_path)
    bucket.files.pipe_file(f"{bucket.name}/other/videos/b", b"b")
    fetch(StorageUrl(f"{bucket.url}/other/videos"), tmp_path)
    assert copied(tmp_path) == {"b": b"b"}


def test_a_folder_with_other_files_is_not_removed(bucket: Bucket, tmp_path: Path) -> None:
    """Catches a copy that deletes the files of a folder that belongs to the user."""
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(
        UserError, match=f"^{tmp_path}: expected a new folder or a copy from a store, got a folder with"
    ):
        fetch(put(bucket, a=b"a"), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_an_object_that_changes_while_it_is_read_is_an_error(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a file with pieces of two versions of an object. The copy of the first version must stay."""
    monkeypatch.setattr("fourd.base.storage.downloading.PIECE_BYTES", 4)
    url = put(bucket, a=b"first")
    fetch(url, tmp_path)
    put(bucket, a=b"second version")
    s3fs = pytest.importorskip("s3fs")
    read, opened = s3fs.S3File.read, []

    def read_and_replace(stream: Any, length: int = -1) -> bytes:
        content: bytes = read(stream, length)
        if not opened:
            opened.append(stream)
            put(bucket, a=b"third  version")
        return content

    monkeypatch.setattr(s3fs.S3File, "read", read_and_replace)
    with pytest.raises(UserError) as caught:
        fetch(url, tmp_path)
    assert str(caught.value) == (
        f"{url}/a: expected an object that stays the same while it is read, got one that was replaced or removed; run "
        "the command again when the object is complete"
    )
    assert copied(tmp_path) == {"a": b"first"}
    fetch(url, tmp_path)
    assert copied(tmp_path) == {"a": b"third  version"}


@pytest.mark.parametrize("key", ["a/../../../x", "a//b", "a\\b", "C:x", "a\x1b[2J", "."])
def test_names_that_leave_the_folder_are_refused(bucket: Bucket, tmp_path: Path, key: str) -> None:
    """Catches an object whose name is a path outside the copy, or whose name writes control characters
    to the terminal.
    """
    url = put(bucket, a=b"a")
    bucket.files.call_s3("put_object", Bucket=bucket.name, Key=f"videos/{key}", Body=b"bad")
    with pytest.raises(UserError) as caught:
        fetch(url, tmp_path / "copies")
    message = str(caught.value)
    assert message == f"{url}: expected names that can be names of files, got the object {key!r}; rename the object"
    assert message.isprintable()
    assert not list(tmp_path.iterdir())


def test_a_copy_must_fit_on_the_disk(bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a download that fills the disk."""
    url = put(bucket, a=b"a")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**12, 10**12, 2**30))  # type: ignore[attr-defined]
    with pytest.raises(UserError, match=f"{url}: expected at most 0.0 GB, the free space in .*; free disk space"):
        fetch(url, tmp_path)
    assert copied(tmp_path) == {}


def test_single_objects_are_copied_for_the_time_of_the_block(bucket: Bucket) -> None:
    """Catches a temporary copy that is not removed, and a message that names the copy instead of the URL."""
    url = StorageUrl(f"{put(bucket, a=b'content')}/a")
    with local_copy(url) as path:
        assert path.name == "a"
        assert path.read_bytes() == b"content"
    assert not path.parent.exists()
    with pytest.raises(UserError) as caught, local_copy(url) as path:
        raise UserError(f"{path}: expected a scene, got text")
    assert str(caught.value) == f"{url}: expected a scene, got text"


def test_copies_keep_the_time_of_the_object(bucket: Bucket, tmp_path: Path) -> None:
    """Catches stages that run again because a new copy of the same object has another modification time."""
    url = put(bucket, a=b"a")
    times = [(fetch(url, tmp_path / name) / "a").stat().st_mtime_ns for name in ("first", "second")]
    assert times[0] == times[1]


MEASURE = """
import resource, sys
from pathlib import Path
from fourd.base.storage import StorageUrl, fetch, upload

peaks = []
for name in ("small", "big"):
    url = StorageUrl(f"{sys.argv[1]}/{name}/video.mp4")
    upload(Path(sys.argv[2]) / name, url)
    fetch(url, Path(sys.argv[2]) / f"copy of {name}")
    peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
print((peaks[1] - peaks[0]) / 1024)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss has other units on other systems")
def test_memory_does_not_depend_on_the_size_of_a_video(bucket: Bucket, tmp_path: Path) -> None:
    """Catches a whole video that is read into memory. The small file already has two parts and several pieces."""
    for name, megabytes in (("small", 20), ("big", 68)):
        with (tmp_path / name).open("wb") as file:
            file.truncate(megabytes << 20)
    words = [sys.executable, "-c", MEASURE, bucket.url, str(tmp_path)]
    grown_mb = float(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
    assert grown_mb < 24
