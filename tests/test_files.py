"""Atomic writing: a file has either its old content or its complete new content."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.base.files import (
    UNFINISHED,
    atomic_folder,
    atomic_path,
    is_unused,
    remove_unfinished,
    remove_unfinished_file,
    remove_unfinished_folder,
    write_text_atomically,
)


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    """Catches a write that changes the target file before the new content is complete."""
    target = tmp_path / "a.json"
    write_text_atomically(target, "old")
    with pytest.raises(OSError, match="full"), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise OSError("the disk is full")
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_permissions_are_those_of_a_plain_file(tmp_path: Path) -> None:
    """Catches files that only their owner can read, as mkstemp creates them."""
    plain, ours = tmp_path / "plain", tmp_path / "deep" / "ours"
    plain.write_text("")
    write_text_atomically(ours, "")
    assert stat.S_IMODE(ours.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_temporary_files_of_killed_processes_are_removed(tmp_path: Path) -> None:
    """Catches temporary files whose names are not recognised, and complete files that are removed."""
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "deep" / "a.json") as temporary:
        assert temporary.name.startswith(UNFINISHED)
        assert temporary.suffix == ".json"
        assert is_unused(tmp_path)
        temporary.rename(temporary.with_name(f"{UNFINISHED}of-a-killed-process.json"))
    write_text_atomically(tmp_path / "whole", "")
    assert not is_unused(tmp_path)
    remove_unfinished(tmp_path)
    assert len(list((tmp_path / "deep").iterdir())) == 1
    remove_unfinished(tmp_path, deep=True)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["deep", "whole"]
    assert is_unused(tmp_path / "nothing")
    assert not is_unused(tmp_path / "whole")


def test_temporary_files_of_one_target_are_removed(tmp_path: Path) -> None:
    """Catches temporary files that remain after a process is killed, and the removal of temporary files that belong to
    a different target.
    """
    for name in ("scene.4dv", "scene-2.4dv"):
        with pytest.raises(FileNotFoundError), atomic_path(tmp_path / name) as temporary:
            ours = temporary.stem.rsplit("-", 1)[0]
            temporary.rename(temporary.with_name(f"{ours}-a_killed{temporary.suffix}"))
    remove_unfinished_file(tmp_path / "scene.4dv")
    left = [path.name for path in tmp_path.iterdir()]
    assert len(left) == 1
    assert left[0].startswith(f"{UNFINISHED}scene-2-")


def test_a_folder_is_replaced_as_a_whole(tmp_path: Path) -> None:
    """Catches a failed write that changes the target folder, and old files that remain in the target folder. Also
    catches temporary folders that remain beside the target folder."""
    target = tmp_path / "results"
    with atomic_folder(target) as folder:
        (folder / "a.txt").write_text("first")
    with pytest.raises(RuntimeError), atomic_folder(target) as folder:
        (folder / "a.txt").write_text("second")
        raise RuntimeError
    assert (target / "a.txt").read_text() == "first"
    with atomic_folder(target) as folder:
        (folder / "b.txt").write_text("third")
    assert [path.name for path in target.iterdir()] == ["b.txt"]
    assert list(tmp_path.iterdir()) == [target]


def test_folders_of_killed_processes_are_removed(tmp_path: Path) -> None:
    """Catches a temporary folder of a killed command that makes all later commands with the same output fail."""
    leftover = tmp_path / f"{UNFINISHED}results-abc"
    leftover.mkdir()
    (leftover / "a.txt").write_text("half")
    remove_unfinished(tmp_path)
    assert not leftover.exists()


def test_pipes_and_devices_are_not_replaced(tmp_path: Path) -> None:
    """Catches a write that replaces a device node, which is possible as root, and a write that blocks on a named
    pipe.
    """
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "device").symlink_to("/dev/null")
    for name, kind in (("pipe", "a named pipe"), ("device", "a device")):
        with pytest.raises(UserError, match=f"{name}: expected a file, got {kind}; name a file"):
            write_text_atomically(tmp_path / name, "text")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["device", "pipe"]


def test_temporary_files_in_use_are_kept(tmp_path: Path) -> None:
    """Catches a command that removes the temporary file of another command, which writes the same file."""
    target = tmp_path / "scene.4dv"
    killed = [tmp_path / f"{UNFINISHED}scene-abcdefgh.4dv"]
    killed.append(tmp_path / f"{UNFINISHED}{killed[0].stem}-abcdefgh.4dv")
    for path in killed:
        path.touch()
    with atomic_path(target) as temporary:
        temporary.write_text("whole")
        remove_unfinished_file(target)
        assert list(tmp_path.iterdir()) == [temporary]
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_is_whole_after_a_kill(tmp_path: Path) -> None:
    """Catches an old folder that is lost if a process is killed while it replaces the folder, and temporary folders
    that remain.
    """
    target = tmp_path / "site"
    with atomic_folder(target) as folder:
        (folder / "page").write_text("old")
    unfinished = tmp_path / f"{UNFINISHED}site-abcdefgh"
    unfinished.mkdir()
    target.rename(tmp_path / f"{UNFINISHED}site-abcdefgh-old")
    (tmp_path / f"{UNFINISHED}other-abcdefgh").mkdir()
    remove_unfinished_folder(target)
    assert (target / "page").read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{UNFINISHED}other-abcdefgh", "site"]
    (tmp_path / f"{UNFINISHED}site-abcdefgh-old").mkdir()
    remove_unfinished_folder(target)
    assert (target / "page").read_text() == "old"
    assert not (tmp_path / f"{UNFINISHED}site-abcdefgh-old").exists()
