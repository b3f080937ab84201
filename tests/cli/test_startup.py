"""The packages that commands import before they answer."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from fourd.cli.loading import load_package
from fourd.cli.main import COMMANDS
from fourd.recording.import_choices import FORMAT_NAMES
from fourd.recording.importing.detection import FORMATS

SCENE = Path(__file__).parents[1] / "baking" / "data" / "version1.4dv"
SLOW = ("torch", "scipy", "cv2", "av", "skimage", "trimesh", "pycolmap", "moderngl", "h5py", "PIL")
"""Packages whose imports take from a twentieth of a second to several seconds."""
RUN = """
import contextlib, io, json, sys
from fourd.cli.main import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main(json.loads(sys.argv[1]))
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""


def imported(*words: str, packages: Sequence[str] = SLOW) -> list[str]:
    """Run a command in a new process, and return which of the packages it imported."""
    process = subprocess.run(
        [sys.executable, "-c", RUN, json.dumps(words)], capture_output=True, text=True, check=True, timeout=300
    )
    names = json.loads(process.stdout.splitlines()[-1])
    return [name for name in packages if name in names]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_imports_no_slow_package(command: str) -> None:
    """``fourd train --help`` imported torch for the type of one option, and took seconds."""
    assert imported(command, "--help") == []


@pytest.mark.parametrize("command", ["calibrate", "check", "matte", "train", "view"])
def test_help_does_not_import_numpy(command: str) -> None:
    """fourd check --help imported NumPy for the names of two files."""
    assert imported(command, "--help", packages=("numpy",)) == []


def test_info_of_a_scene_imports_no_slow_package() -> None:
    """``fourd info SCENE`` imported scipy and OpenCV, although it only reads the header of the file."""
    assert imported("info", str(SCENE)) == []


def test_the_version_imports_neither_tyro_nor_rich() -> None:
    """``fourd --version`` imported the parser of the options, which it does not need."""
    process = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "fourd", "--version"], capture_output=True, text=True, check=True
    )
    packages = {line.rpartition("|")[2].strip().partition(".")[0] for line in process.stderr.splitlines()}
    assert not packages & {"tyro", "rich", "numpy"}


def test_the_listed_formats_are_those_of_the_importer() -> None:
    """A new importer was missing in ``fourd import --help``, whose list of names does not import the importers."""
    assert tuple(each.name for each in FORMATS) == FORMAT_NAMES


class Screen(io.StringIO):
    """The text that was sent to a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of a package that is not imported."""
    (tmp_path / "slow_package.py").write_text("import sys\nsys.stderr.write('(importing)')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "slow_package", raising=False)
    return "slow_package"


def test_a_terminal_shows_what_is_loaded(slow: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches seconds without a word, and a line that stays."""
    monkeypatch.setattr(sys, "stderr", screen := Screen())
    load_package(slow)
    assert screen.getvalue() == f"loading slow_package\r(importing){' ' * 20}\r"
    load_package(slow)
    assert screen.getvalue().count("loading") == 1
    monkeypatch.delitem(sys.modules, slow)


def test_a_log_shows_nothing(slow: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a line in the log of a batch job, and an import that the command may not need."""
    monkeypatch.setattr(sys, "stderr", log := io.StringIO())
    load_package(slow)
    assert log.getvalue() == ""
    assert slow not in sys.modules
