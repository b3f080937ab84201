"""Files are old or new, never in between."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from fourd.files import atomic_path, write_text_atomically


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    """Catches writing in place."""
    target = tmp_path / "a.json"
    write_text_atomically(target, "old")
    with pytest.raises(OSError, match="full"), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise OSError("the disk is full")
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_permissions_are_those_of_a_plain_file(tmp_path: Path) -> None:
    """Catches files that only their maker can read, as mkstemp makes them."""
    plain, ours = tmp_path / "plain", tmp_path / "deep" / "ours"
    plain.write_text("")
    write_text_atomically(ours, "")
    assert stat.S_IMODE(ours.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)
