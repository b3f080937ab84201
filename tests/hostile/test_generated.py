"""Tests with generated hostile files of every kind and with generated command lines. Each command must end with one
error line, use little memory and time, and damage no file.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.hostile.files import Case
from tests.hostile.mutations import damage_file
from tests.hostile.samples import Sample, Samples
from tests.hostile.test_hostile import run_case
from tests.hostile.words import HostileWords, is_safe

FILES, SLOW_FILES = 100, 1000
COMMANDS, SLOW_COMMANDS = 30, 300
QUICK = ("info", "verify", "check")
"""Commands of the quick test. With undamaged files, these commands take little time."""


def snapshot(folder: Path, left_out: tuple[str, ...]) -> dict[str, int]:
    """Modification times of all files below a folder, by path. Files and folders directly inside the folder are skipped
    if their names start with a text in ``left_out``.
    """
    found = {}
    for parent, folders, files in os.walk(folder):
        if Path(parent) == folder:
            folders[:] = [name for name in folders if not name.startswith(left_out)]
            files = [name for name in files if not name.startswith(left_out)]
        found |= {path: os.lstat(path).st_mtime_ns for path in (os.path.join(parent, name) for name in files)}
    return found


def hostile_files(samples: list[Sample], folder: Path, rng: np.random.Generator, quick: bool) -> Iterator[Case]:
    """Endless cases. The damaged copy of a sample is written when the case is requested."""
    while True:
        for sample in samples:
            commands = [words for words in sample.commands if not quick or words[0] in QUICK]
            if not commands:
                continue
            copy = folder / "case" / sample.folder.name
            shutil.rmtree(copy.parent, ignore_errors=True)
            shutil.copytree(sample.folder, copy)
            how = damage_file(copy / sample.file, rng)
            places = {"FILE": str(copy / sample.file), "DIR": str(copy)}
            words = commands[rng.integers(len(commands))]
            yield Case(
                f"{words[0]} of {sample.name}: {how}", tuple(_place(word, places, folder) for word in words), (0, 2)
            )


def _place(word: str, places: dict[str, str], folder: Path) -> str:
    if word.startswith("OUT"):
        return str(folder / word.lower())
    for name, path in places.items():
        if word == name or word.startswith(f"{name}/"):
            return path + word[len(name) :]
    return word


def run_files(tmp_path: Path, rng: np.random.Generator, count: int, quick: bool) -> None:
    samples = Samples(tmp_path / "samples").all
    names = ("case", "out", "log", "failed")
    before, faults = snapshot(tmp_path, names), {}
    cases = hostile_files(samples, tmp_path, rng, quick)
    for number in range(count):
        case = next(cases)
        fault = run_case(case, tmp_path / "log")
        if fault:
            faults[f"{number}, {case.name}"] = fault
            shutil.copytree(tmp_path / "case", tmp_path / "failed" / str(number), symlinks=True, ignore=_no_pipes)
    assert not faults, f"{len(faults)} of {count}, kept in {tmp_path / 'failed'}:\n" + "\n".join(
        f"{name}: {fault}" for name, fault in faults.items()
    )
    assert snapshot(tmp_path, names) == before, "a file outside the output was changed"


def _no_pipes(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if not (Path(folder, name).is_file() or Path(folder, name).is_dir())]


def run_commands(tmp_path: Path, rng: np.random.Generator, count: int) -> None:
    samples = Samples(tmp_path / "samples").all
    scene = next(sample.folder / sample.file for sample in samples if sample.name == "object scene")
    words = HostileWords(scene, tmp_path / "samples" / "ball", tmp_path / "out", rng)
    # A hostile word can replace the path of the output. The output is then in the working folder.
    names = ("out", "log", "absent", "here")
    before, faults, done = snapshot(tmp_path, names), {}, 0
    while done < count:
        line = words.next()
        if not is_safe(line):
            continue
        fault = run_case(Case(line[0], line, (0, 2)), tmp_path / "log")
        done += 1
        if fault:
            faults[" ".join(repr(word[:60]) for word in line)] = fault
    assert not faults, "\n".join(f"{name}: {fault}" for name, fault in faults.items())
    assert snapshot(tmp_path, names) == before, "a file outside the output was changed"


def test_damaged_files_end_with_one_line(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches tracebacks, crashes, hangs, unbounded memory and changed files, with damaged files of all kinds."""
    run_files(tmp_path, rng, FILES, quick=True)


def test_hostile_command_lines_end_with_one_line(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches tracebacks, hangs, and files that are written outside the output, with option values that are out of
    range.
    """
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    run_commands(tmp_path, rng, COMMANDS)


@pytest.mark.slow
def test_many_damaged_files_end_with_one_line(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches the errors of :func:`test_damaged_files_end_with_one_line`, with more files and with all commands."""
    run_files(tmp_path, rng, SLOW_FILES, quick=False)


@pytest.mark.slow
def test_many_hostile_command_lines_end_with_one_line(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches the errors of :func:`test_hostile_command_lines_end_with_one_line`, with more command lines."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    run_commands(tmp_path, rng, SLOW_COMMANDS)
