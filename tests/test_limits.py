"""Checks of untrusted files: their kind, size and nesting, and the text that is printed from them."""

from __future__ import annotations

import os
from fractions import Fraction
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.base.limits import open_regular, printable, read_fraction, read_json, read_limited, require_regular
from fourd.base.progress import Terminal


def test_pipes_and_devices_are_refused_at_once(tmp_path: Path) -> None:
    """Catches a reader that blocks forever on a named pipe, or that fills the memory with bytes from /dev/zero."""
    pipe, device = tmp_path / "pipe", tmp_path / "device"
    os.mkfifo(pipe)
    device.symlink_to("/dev/zero")
    for path, kind in ((pipe, "a named pipe"), (device, "a device")):
        for read in (require_regular, open_regular, read_limited, read_json):
            with pytest.raises(UserError, match=f"{path}: expected a file, got {kind}"):
                read(path)


def test_missing_files_and_folders_are_errors_of_the_system(tmp_path: Path) -> None:
    """Catches a general error message that replaces a reader's own message for a missing file. Also catches file
    descriptors of folders that stay open.
    """
    descriptors = len(os.listdir("/proc/self/fd"))
    require_regular(tmp_path / "absent")
    require_regular(tmp_path)
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "absent")
    with pytest.raises(IsADirectoryError):
        open_regular(tmp_path)
    assert len(os.listdir("/proc/self/fd")) == descriptors


def test_large_files_are_refused_before_memory_is_taken(tmp_path: Path) -> None:
    """Catches a reader that reads a sparse file of one terabyte into memory."""
    path = tmp_path / "large.json"
    with path.open("wb") as stream:
        stream.truncate(1 << 40)
    with pytest.raises(UserError, match=r"large.json: expected at most 64 MB, got 1048576.0 MB"):
        read_json(path)
    path.write_bytes(b"12345")
    assert read_limited(path, 5) == b"12345"
    with pytest.raises(UserError, match="expected at most"):
        read_limited(path, 4)


def test_deep_json_is_a_value_error(tmp_path: Path) -> None:
    """Catches a RecursionError for nested lists, which readers of damaged files do not expect."""
    path = tmp_path / "deep.json"
    path.write_text("[" * 100_000)
    with pytest.raises(ValueError, match="deeply nested"):
        read_json(path)


def test_fractions_are_small() -> None:
    """Catches the frame rate "1e99999999", whose fraction needs minutes and gigabytes."""
    assert read_fraction("30000/1001") == Fraction(30000, 1001)
    assert (read_fraction(25), read_fraction(0.5), read_fraction("29.97")) == (25, Fraction(1, 2), Fraction(2997, 100))
    for value in ("1e99999999", "9" * 5000, 10**65, None, True, [], float("inf"), "1/0", "x"):
        with pytest.raises((TypeError, ValueError, ZeroDivisionError)):
            read_fraction(value)


def test_text_cannot_control_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches names from files that change the terminal's title, add lines, or are parsed as markup."""
    assert printable("ü 05") == "ü 05"
    assert printable("a\x1b]0;b\x07\n\udcff") == "a\\x1b]0;b\\x07\\n\\udcff"
    Terminal().print("cam\x1b[2J[/x] [bold]b[/bold]", soft_wrap=True)
    assert capsys.readouterr().out == "cam\\x1b[2J[/x] [bold]b[/bold]\n"
