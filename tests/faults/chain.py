"""The commands that turn a tiny capture into a scene, and functions that compare their results."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from safetensors import safe_open

from fourd.base.files import UNFINISHED
from tests.captures import write_ball_capture
from tests.faults.command_process import Job, run_job
from tests.faults.operations import Mode
from tests.processes.forked import start

TIMES = ("metrics.jsonl", "events.out.tfevents")
"""Files whose names start with these texts contain times."""
STATE_TIMES = ("session", "seconds", "updated")
"""Fields of a training's state that contain times or the name of one session."""
EXPORTED = ".export"
SMALL = (
    "points=200",
    "layers=4",
    "least_layers=3",
    "max_steps=2",
    "checkpoint_steps=1",
    "model.hidden=8",
    "model.planes.levels=1",
    "model.planes.features=2",
    "model.planes.base_resolution=8",
)


@dataclass(frozen=True)
class Command:
    """A command, and the folder that the command writes. Paths are relative to the working folder of the test."""

    words: tuple[str, ...]
    output: str

    @property
    def name(self) -> str:
        return self.words[0]


COMMANDS = (
    Command(("import", "easymocap", "source", "capture", "--copy"), "capture"),
    Command(("matte", "capture", "--method", "masks", "--masks", "source/given", "--workers", "1"), "capture"),
    Command(("carve", "capture", "-o", "hulls", "--points", "200", "--workers", "1"), "hulls"),
    Command(("train", "capture", "-o", "run", "--workers", "1", *(w for s in SMALL for w in ("--set", s))), "run"),
    Command(("export", "run", "-o", "out/scene.4dv"), "out"),
)
MAKE = Command(
    ("make", "source", "-o", "out/scene.4dv", "--workers", "1", *(w for s in SMALL for w in ("--set", s))), "out"
)


@dataclass(frozen=True)
class Outcome:
    """The result of a command.

    Attributes:
        code: exit code, or the negative number of a signal.
        text: output of the command.
        operations: the operations that the command did, or an empty list if the command was killed.
    """

    code: int
    text: str
    operations: list[str]


class Runner:
    """Runs each command in a process of its own. The files of a runner's commands are in ``folder``, so that commands
    of two runners can run at the same time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        start(int).join()  # from now on, the first command starts as quickly as the others

    def run(
        self, command: Command, root: Path, mode: Mode = "count", at: int = -1, signal: int = 0, seconds: float = 0.0
    ) -> Outcome:
        """Run a command in the folder ``root``. The operation with the index ``at`` gets a fault of the kind ``mode``,
        or the process gets a signal after ``seconds``."""
        words = list(command.words)
        if command.name == "train" and (root / "run" / "config.yaml").exists():
            words.append("--resume")
        words = [str(root / word) if _is_path(word) else word for word in words]
        log, operations = self._folder / "log", self._folder / "operations"
        for file in (log, operations):
            file.unlink(missing_ok=True)
        process = start(run_job, Job(tuple(words), root, mode, at, log, operations))
        if signal:
            process.join(seconds)
            if process.is_alive() and process.pid is not None:
                os.kill(process.pid, signal)
        process.join()
        assert process.exitcode is not None
        text = log.read_text(encoding="utf-8") if log.exists() else ""  # it may be killed before it opens the log
        done = json.loads(operations.read_text()) if operations.exists() else []
        return Outcome(process.exitcode, text, done)


def _is_path(word: str) -> bool:
    return word.split("/")[0] in ("source", "capture", "hulls", "run", "out")


def write_source(root: Path) -> None:
    """Write a capture of three cameras and one frame, with masks in a separate folder."""
    write_ball_capture(root / "source", cameras=3, frames=1, size=48)
    (root / "source" / "masks").rename(root / "source" / "given")


def restore(snapshot: Path, root: Path) -> None:
    """Replace the folder ``root`` by a copy of ``snapshot``. The copies have the modification times of the
    originals.
    """
    shutil.rmtree(root, ignore_errors=True)
    shutil.copytree(snapshot, root, symlinks=True)


def contents(root: Path) -> dict[str, bytes]:
    """A dictionary from the path of each file below a folder to its content, without times and durations."""
    found = {}
    for path in sorted(root.rglob("*")):
        if path.is_file() and not path.name.startswith(TIMES):
            found[str(path.relative_to(root))] = _content(path)
    return found


def leftovers(root: Path) -> list[str]:
    """Temporary files and scratch folders below a folder."""
    marks = (UNFINISHED, EXPORTED)
    found = [path for path in root.rglob("*") if path.name.startswith(marks) or path.name == "scratch"]
    return [str(path.relative_to(root)) for path in found]


def partial_files(root: Path, before: dict[str, bytes], after: dict[str, bytes]) -> Iterator[str]:
    """The names of files that have neither the content from before the command nor the content after a complete
    command.

    In a JSON file, any complete JSON object is allowed. Temporary files, and files that are missing both before and
    after the command, are not examined.
    """
    for name, content in contents(root).items():
        is_known = content in (before.get(name), after.get(name)) or (name.endswith(".json") and _is_json(content))
        is_temporary = any(part.startswith((UNFINISHED, EXPORTED, "scratch")) for part in Path(name).parts)
        if not is_known and not is_temporary and (name in before or name in after):
            yield name


def _is_json(content: bytes) -> bool:
    try:
        return isinstance(json.loads(content), dict)
    except ValueError:
        return False


def _without_times(state: bytes) -> bytes:
    """The state of a training without the fields that differ between two equal trainings."""
    try:
        fields = json.loads(state)
    except ValueError:
        return state
    return json.dumps({name: value for name, value in fields.items() if name not in STATE_TIMES}).encode()


def _content(path: Path) -> bytes:
    if path.name == "state.json":
        return _without_times(path.read_bytes())
    if path.suffix != ".safetensors" or path.parent.name != "checkpoints":
        return path.read_bytes()
    try:
        with safe_open(path, framework="np") as stream:
            header = stream.metadata()
            tensors = {name: stream.get_tensor(name).tobytes().hex() for name in stream.keys()}  # noqa: SIM118
    except Exception:
        return path.read_bytes()
    return json.dumps([header["step"], header["points"], tensors]).encode()
