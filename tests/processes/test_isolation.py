"""Parsers in a child process. Crashes, hangs and a lack of memory in the parser must become error messages."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.base.processes import isolation
from fourd.base.processes.isolation import ParserProcess
from tests.processes.shared import OWN

PARSERS = "tests.processes.parsers"


@pytest.fixture(autouse=True)
def _no_shared_parsers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The child processes end as they do in programs; see :func:`tests.processes.shared.shared_parsers`."""
    for name, method in OWN.items():
        monkeypatch.setattr(ParserProcess, name, method)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "file.bin"
    path.write_bytes(bytes(range(256)))
    return path


def test_replies_are_values_and_bytes(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches replies that are mixed with the output of libraries, and modules from the working directory."""
    (tmp_path / "json.py").write_text("raise SystemExit('the module of the working directory was imported')")
    monkeypatch.chdir(tmp_path)
    with ParserProcess() as parser:
        first = parser.call(f"{PARSERS}:read", file, "!")
        assert (first.value["name"], first.value["number"]) == ("file.bin!", float("inf"))
        assert first.content == file.read_bytes()
        second = pickle.loads(pickle.dumps(parser)).call(f"{PARSERS}:read", file, "")
        assert parser.call(f"{PARSERS}:read", file, "").value["process"] == first.value["process"]
        assert second.value["process"] != first.value["process"]
    with pytest.raises(ProcessLookupError):
        os.kill(first.value["process"], 0)


def test_a_crash_is_one_line(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a parser whose crash, hang or lack of memory ends the program, and a child process that is not started
    again."""
    monkeypatch.setattr(isolation, "SECONDS", 0.5)
    expected = {
        "crash": r"got one on which the reader crashes \(SIGSEGV\)",
        "take_memory": "got one that needs more than 2 GB",
        "spin": "got one whose reading does not end",
        "fail": "got one on which the reader fails",
        "refuse": r"expected\\x1b\[2J a parser, got none; fix it",
    }
    with ParserProcess() as parser:
        for name, message in expected.items():
            with pytest.raises(UserError, match=f"file.bin: .*{message}") as error:
                parser.call(f"{PARSERS}:{name}", file)
            assert "\n" not in str(error.value)
            assert parser.call(f"{PARSERS}:read", file, "").content


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a process with its parent")
def test_the_child_ends_with_its_parent(file: Path) -> None:
    """Catches an orphan process after kill -9."""
    program = f"""
import threading, time
from pathlib import Path
from fourd.base.processes.isolation import ParserProcess
parser = ParserProcess()
print(parser.call("{PARSERS}:read", Path({str(file)!r}), "").value["process"], flush=True)
parser.call("{PARSERS}:sleep", Path({str(file)!r}))
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, env=environment
    ) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        parent.kill()
    deadline = time.monotonic() + 30
    while Path(f"/proc/{child}").exists() and time.monotonic() < deadline:
        if Path(f"/proc/{child}/stat").read_text().split(")")[1].split()[0] == "Z":
            break
        time.sleep(0.05)
    else:
        assert not Path(f"/proc/{child}").exists()
