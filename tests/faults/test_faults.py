"""Tests that no result is lost or damaged if a file operation fails. The faults are in the commands that make a scene
from images.
"""

from __future__ import annotations

import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.faults.chain import (
    COMMANDS,
    MAKE,
    Command,
    Outcome,
    Runner,
    contents,
    leftovers,
    partial_files,
    restore,
    write_source,
)
from tests.faults.operations import MODES, Mode

QUICK_FAULTS = 2
"""Number of faults of each kind in the quick test."""
PAIRS = 4
"""Number of times that two calls of each command run at the same time."""
MAX_DELAY = 1.5
"""Maximum time in seconds between the starts of the two calls."""
READERS = (
    Command(("eval", "run", "--views", "00"), "run"),
    Command(("render", "run", "--path", "orbit", "--steps", "2", "-o", "out/images"), "out"),
    Command(("render", "out/scene.4dv", "--path", "orbit", "--steps", "2", "-o", "out/images"), "out"),
    Command(("pack", "out/scene.4dv", "-o", "out/packed.4dv"), "out"),
    Command(("web", "out/scene.4dv", "-o", "out/site"), "out"),
    Command(("mesh", "capture", "-o", "out/meshes"), "out"),
    Command(("fit-triangles", "capture", "-o", "out/mesh.ply", "--triangles", "500", "--max-steps", "2"), "out"),
    Command(("synth", "out/synthetic", "--frames", "1", "--cameras", "3", "--size", "32"), "out"),
    MAKE,
    Command(("check", "capture"), "capture"),
    Command(("info", "run"), "run"),
    Command(("verify", "run"), "run"),
)
"""Further commands for the folder in which all of COMMANDS have run."""
CODES: dict[Mode, tuple[int, ...]] = {
    "full": (0, 2),
    "memory": (0, 2),
    "interrupt": (0, 2, 130),
    "kill": (-9,),
}


@dataclass(frozen=True)
class Stage:
    """A command, a copy of the working folder before the command, the contents of the folder after the command, and the
    operations that the command does.
    """

    command: Command
    before: Path
    after: dict[str, bytes]
    operations: list[str]


@dataclass(frozen=True)
class Chain:
    """All commands, and what runs them in the folder ``root``."""

    runner: Runner
    root: Path
    stages: tuple[Stage, ...]


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Chain:
    folder = tmp_path_factory.mktemp("faults").resolve()
    root, stages = folder / "work", []
    write_source(root)
    runner = Runner(folder)
    for number, command in enumerate(COMMANDS):
        before = folder / f"before {number}"
        shutil.copytree(root, before, symlinks=True)
        outcome = runner.run(command, root)
        assert outcome.code == 0, outcome.text
        assert leftovers(root) == []
        stages.append(Stage(command, before, contents(root), outcome.operations))
    return Chain(runner, root, tuple(stages))


def find_fault(chain: Chain, stage: Stage, mode: Mode, at: int) -> str:
    """Let one operation of a command fail, and run the command again. Returns a description of the error, or an empty
    text if the results are correct.
    """
    restore(stage.before, chain.root)
    before = contents(chain.root)
    failed = chain.runner.run(stage.command, chain.root, mode, at)
    message = _wrong_message(stage.command, mode, failed)
    if message:
        return message
    partial = list(partial_files(chain.root, before, stage.after))
    if partial:
        return f"neither old nor new: {partial}"
    again = chain.runner.run(stage.command, chain.root)
    if again.code != 0:
        return f"the next run ends with {again.code}: {again.text[-300:]}"
    if leftovers(chain.root):
        return f"left over: {leftovers(chain.root)}"
    now = contents(chain.root)
    different = sorted(name for name in now.keys() | stage.after.keys() if now.get(name) != stage.after.get(name))
    return f"other contents after the next run: {different}" if different else ""


def _wrong_message(command: Command, mode: Mode, outcome: Outcome) -> str:
    if outcome.code not in CODES[mode]:
        return f"exit code {outcome.code}: {outcome.text[-300:]}"
    if "Traceback" in outcome.text:
        return f"traceback: {outcome.text[-300:]}"
    lines = [line for line in outcome.text.splitlines() if line.startswith(f"fourd {command.name}: ")]
    if outcome.code == 2 and len(lines) != 1:
        return f"not one line: {outcome.text[-300:]}"
    return ""


def run_faults(chain: Chain, faults: list[tuple[int, Mode, int]]) -> None:
    wrong = []
    for number, mode, at in faults:
        stage = chain.stages[number]
        fault = find_fault(chain, stage, mode, at)
        if fault:
            wrong.append(f"{stage.command.name}, {mode} at operation {at} ({stage.operations[at]}): {fault}")
    assert not wrong, f"{len(wrong)} of {len(faults)} faults:\n" + "\n".join(wrong)


def all_faults(chain: Chain) -> list[tuple[int, Mode, int]]:
    return [
        (number, mode, at)
        for number, stage in enumerate(chain.stages)
        for mode in MODES
        for at in range(len(stage.operations))
    ]


def test_some_faults_lose_nothing(chain: Chain, rng: np.random.Generator) -> None:
    """Catches partly written files, lost results, leftover files, and a next run whose results differ from the results
    without faults.
    """
    faults = all_faults(chain)
    chosen = [
        each
        for mode in MODES
        for each in rng.permutation(np.array([index for index, fault in enumerate(faults) if fault[1] == mode]))[
            :QUICK_FAULTS
        ]
    ]
    run_faults(chain, [faults[index] for index in chosen])


@pytest.mark.slow
def test_every_fault_loses_nothing(chain: Chain) -> None:
    """Catches the errors of :func:`test_some_faults_lose_nothing`, for every operation of every command."""
    faults = all_faults(chain)
    print(f"{len(faults)} faults of {sum(len(stage.operations) for stage in chain.stages)} operations")
    run_faults(chain, faults)


def run_two(chain: Chain, other: Runner, command: Command, delay: float) -> str:
    """Run a command, and the same command ``delay`` seconds later. Returns a description of what is wrong."""
    with ThreadPoolExecutor() as pool:
        first = pool.submit(chain.runner.run, command, chain.root)
        time.sleep(delay)
        second = pool.submit(other.run, command, chain.root)
        outcomes = [first.result(), second.result()]
    wrong = [message for outcome in outcomes if (message := _wrong_message(command, "full", outcome))]
    if not wrong and all(outcome.code for outcome in outcomes):
        wrong = [f"neither ended: {outcome.text[-300:]}" for outcome in outcomes]
    if leftovers(chain.root):
        wrong.append(f"left over: {leftovers(chain.root)}")
    return "; ".join(wrong)


@pytest.mark.slow
def test_two_commands_at_once_lose_nothing(chain: Chain, tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches commands that use each other's unfinished files, and a second command that ends with a traceback."""
    wrong = []
    other = Runner(tmp_path)
    for stage in chain.stages * PAIRS:
        restore(stage.before, chain.root)
        fault = run_two(chain, other, stage.command, float(rng.uniform(0, MAX_DELAY)))
        is_same = contents(chain.root) == stage.after
        if fault or not is_same:
            wrong.append(f"{stage.command.name}: {fault or 'other contents than of one command'}")
    (chain.root / "source" / "given").rename(chain.root / "source" / "masks")  # for MAKE
    for command in READERS * PAIRS:
        fault = run_two(chain, other, command, float(rng.uniform(0, MAX_DELAY)))
        if fault:
            wrong.append(f"{command.name}: {fault}")
    assert not wrong, "\n".join(wrong)
