"""Runs the commands of a user on a random capture, and describes what came of it."""

from __future__ import annotations

import io
import shutil
import time
import traceback
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

from fourd.cli.main import main
from tests.random_captures.recipes import Recipe

OVERLAY = """\
points: 400
checkpoint_steps: 20
model: {hidden: 16, planes: {levels: 2, features: 4, base_resolution: 16}}
background: {points: 500, radiance: {steps: 8, rays: 256}}
"""
MAX_STEPS = 5


@dataclass(frozen=True)
class Outcome:
    """Result of one command.

    Attributes:
        command: the command's name.
        code: its exit code, or 1 if it raised an error.
        message: its one line on stderr if the code is 2, or the traceback if it is 1.
        output: its output.
        seconds: its duration.
    """

    command: str
    code: int
    message: str
    output: str
    seconds: float

    @property
    def is_proper(self) -> bool:
        """Whether the command succeeded, or refused its input with one line that names the command."""
        is_line = self.message.startswith(f"fourd {self.command}: ") and "\n" not in self.message
        return self.code == 0 or (self.code == 2 and is_line)


def run_all(source: Path, recipe: Recipe) -> list[Outcome]:
    """Run ``import``, ``check``, ``matte`` and ``make`` on the recipe's capture or videos in ``source``."""
    work = source.parent / "work"
    overlay = source.parent / "small.yaml"
    overlay.write_text(OVERLAY)
    outcomes = [run(["import", source, work / "capture", "--copy"])]
    capture = source if recipe.is_calibrated else work / "capture"
    if not recipe.is_calibrated and outcomes[0].code:
        # The cameras could not be calibrated, so there is no capture. fourd make must refuse the videos likewise.
        return [*outcomes, _make(source, work, overlay, recipe)]
    outcomes.append(run(["check", capture]))
    bare = work / "bare"
    shutil.copytree(capture, bare, symlinks=True)
    shutil.rmtree(bare / "masks", ignore_errors=True)
    outcomes.append(run(["matte", bare, "--workers", 1]))
    outcomes.append(_make(capture, work, overlay, recipe))
    return outcomes


def _make(source: Path, work: Path, overlay: Path, recipe: Recipe) -> Outcome:
    words = ["make", source, "-o", work / "scene.4dv", "--max-steps", MAX_STEPS, "--config", overlay, "--workers", 1]
    return run([*words, "--scene", recipe.scene])


def run(words: list[str | Path | int]) -> Outcome:
    """Run a command in this process."""
    out, err, start = io.StringIO(), io.StringIO(), time.monotonic()
    code, message = 1, ""
    try:
        with redirect_stdout(out), redirect_stderr(err):
            code = main([str(word) for word in words])
    except Exception:
        message = traceback.format_exc()
    lines = [line for line in err.getvalue().splitlines() if line.startswith("fourd ")]
    message = message or "\n".join(lines)
    return Outcome(str(words[0]), code, message, out.getvalue() + err.getvalue(), time.monotonic() - start)
