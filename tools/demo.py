"""Run ``make demo``: make a synthetic capture, train and export a scene, render a video and compute scores.

The program prints and runs the commands that a user would type.
"""

from __future__ import annotations

import json
import shlex
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from fourd.cli.main import main as fourd
from fourd.errors import command_line

TEST_VIEWS = "03,09"


@dataclass(frozen=True)
class Arguments:
    """Options of the demonstration."""

    folder: Path = Path("demo")
    """Folder for all files. Stages whose results it already contains are skipped."""
    seconds: int = 320
    """Time limit of training in seconds."""


def step(*words: object) -> None:
    """Print and run one fourd command. Exit if the command fails."""
    arguments = [str(word) for word in words]
    print(f"\n$ fourd {shlex.join(arguments)}", flush=True)
    code = fourd(arguments)
    if code != 0:
        sys.exit(code)


def main() -> None:
    """Make all files of the demonstration, and skip stages that are already finished."""
    arguments = tyro.cli(Arguments, description=__doc__)
    started = time.monotonic()
    folder = arguments.folder
    capture, scene, video = folder / "capture", folder / "scene.4dv", folder / "orbit.mp4"
    figures, run = folder / "eval.json", folder / "scene.work" / "run"
    if not (capture / "intri.yml").exists():
        step("synth", capture, "--frames", 16, "--cameras", 16, "--size", 320)
    step("make", capture, "-o", scene, "--test-views", TEST_VIEWS, "--max-seconds", arguments.seconds)
    step("eval", run, "--json", figures)
    step("render", scene, "--path", "orbit", "--out", video, "--size", 512, 512)
    scores = json.loads(figures.read_text())
    megabytes = scene.stat().st_size / 2**20
    print(
        f"\nFinished in {time.monotonic() - started:.0f} s: {scene} ({megabytes:.0f} MB) and {video}."
        f"\nHeld-out cameras {TEST_VIEWS}: {scores['image']['psnr']:.2f} dB PSNR on the whole image, "
        f"{scores['box']['psnr']:.2f} dB in the foreground's box."
        f"\nNext: open {video}; {command_line('fourd', 'view', scene)}; "
        f"{command_line('fourd', 'render', scene, '--path', 'spiral', '--out', 'spiral.mp4')}; "
        "fourd make YOUR_CAPTURE -o scene.4dv"
    )


if __name__ == "__main__":
    main()
