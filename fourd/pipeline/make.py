"""``fourd make``: every stage from videos or a capture to a scene, each done once for the same input and settings."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from rich.console import Console

from fourd.baking.bake import bake_run
from fourd.capture.calibration import INTRINSICS_NAME
from fourd.capture.check import check_capture
from fourd.capture.layout import VIDEOS, camera_folders
from fourd.capture.video_index import index_capture
from fourd.errors import UserError
from fourd.files import is_unused, remove_unfinished, remove_unfinished_file, write_text_atomically
from fourd.importing.importer import ImportOptions, import_source, pick_format
from fourd.matting.prepare import make_all
from fourd.matting.selection import Selection
from fourd.matting.stage import SHEET, MatteSettings
from fourd.progress import Track, Tracker, console_log
from fourd.training.background_seed import BACKGROUND, DECIDING, POINTS
from fourd.training.cameras.calibration import CALIBRATION, START
from fourd.training.config import TrainConfig
from fourd.training.loop import Trainer
from fourd.training.losses.lpips import LPIPS
from fourd.training.run import (
    CONFIG_NAME,
    STAGES,
    adjust_run_cameras,
    carve_run,
    create_run,
    load_run,
    open_run,
    seed_run,
)

INPUT_PATTERNS = ("*.yml", "videos.json", "videos/*", "images/*/*", "masks/*/*")
SOURCE_PATTERNS = ("*", "*/*", "*/*/*")
CAPTURE = "capture"
ADJUSTED_BY = ("poses", "focal", "rotation_deg", "position", "focal_spread", "band")
"""Settings of refinement that the cameras before carving depend on."""
MATTE_PATTERNS = (".fourd/mattes/*/*",)


class Stages:
    """Which stages are done, kept in ``stages.json``: stage name -> the key of what it was done for."""

    def __init__(self, folder: Path, console: Console) -> None:
        self.folder = folder
        self.console = console
        self._path = folder / "stages.json"
        self._done = self._read()

    def run(self, name: str, key: str, work: Callable[[], object], result: Path, undo: Callable[[], None]) -> None:
        """Do a stage unless it was done for the same key and its result is still there.

        ``undo`` removes what an earlier, different key left behind; the same key goes on with it.
        """
        if self._done.get(name) == key and result.exists():
            self.console.print(f"{name}: found done ({result})", soft_wrap=True)
            return
        begun = self._done.get(f"{name} begun")
        if begun is not None and begun != key:
            undo()
        self._record(f"{name} begun", key)
        self.console.print(f"{name}: working", soft_wrap=True)
        work()
        self._record(name, key)
        self.console.print(f"{name}: done ({result})", soft_wrap=True)

    def _record(self, name: str, key: str) -> None:
        self._done[name] = key
        write_text_atomically(self._path, json.dumps(self._done, indent=1) + "\n")

    def _read(self) -> dict[str, str]:
        try:
            content = json.loads(self._path.read_text())
        except (FileNotFoundError, json.JSONDecodeError):
            return {}
        return {str(name): str(key) for name, key in content.items()} if isinstance(content, dict) else {}


@dataclass(frozen=True)
class MakeSettings:
    """What the stages before carving depend on.

    Attributes:
        mattes: how mattes are made where the capture has none.
        workers: processes that make them, and carve.
    """

    mattes: MatteSettings
    workers: int


def make_scene(
    capture: Path, out: Path, settings: MakeSettings, train: TrainConfig, lpips: LPIPS | None, console: Console
) -> None:
    """Import, check, matte, carve, train and export ``capture`` into the scene file ``out``.

    What is no capture is imported beside ``out``; so is one without masks in a folder that cannot be written to.
    The stages' results lie in a folder beside ``out``, named after it. A changed input or setting
    redoes the stages that depend on it; an interrupted one goes on where it stopped.
    """
    work = out.with_suffix(".work")
    if not (work / "stages.json").exists() and not is_unused(work):
        raise UserError(f"{work}: expected a folder made by fourd make, got another; move it or choose another -o")
    work.mkdir(parents=True, exist_ok=True)
    remove_unfinished(work, deep=True)
    remove_unfinished_file(out)
    stages, run = Stages(work, console), work / "run"
    capture, inputs = _prepared(stages, capture, settings, train)
    carve_key = _seeded(stages, capture, run, settings, train, inputs)
    train_key = _key(carve_key, asdict(train))
    stages.run(
        "train",
        train_key,
        lambda: _train(capture, run, train, lpips, console),
        run / "checkpoints",
        lambda: _remove(run, keep=STAGES),
    )
    stages.run("export", train_key, lambda: bake_run(load_run(run), out, console), out, lambda: None)


def _prepared(stages: Stages, capture: Path, settings: MakeSettings, train: TrainConfig) -> tuple[Path, str]:
    """Import, check and matte: the folder of the capture to train on, and a key of what was in it."""
    console, track = stages.console, Tracker(stages.console).track
    if not _is_usable(capture):
        source, capture = capture, stages.folder / CAPTURE
        key = fingerprint(source, SOURCE_PATTERNS)
        stages.run("import", key, lambda: _bring_in(source, capture, console), capture, lambda: _remove(capture))
    inputs = fingerprint(capture)
    stages.run("check", inputs, lambda: _check(capture, track), capture, lambda: None)
    if not camera_folders(capture / "masks"):
        selection = Selection(capture, train.views, train.frames)
        stages.run(
            "mattes",
            _key(inputs, asdict(settings.mattes), train.views, train.frames),
            lambda: make_all(selection, settings.mattes, settings.workers, track, plates=True),
            capture / SHEET,
            lambda: None,
        )
    return capture, inputs


def _seeded(stages: Stages, capture: Path, run: Path, settings: MakeSettings, train: TrainConfig, inputs: str) -> str:
    """Correct cameras where that is wanted, carve, and find a full scene's background: a key of what was carved."""
    track, log = Tracker(stages.console).track, console_log(stages.console)
    training = asdict(train)
    selection = {name: training[name] for name in ("views", "test_views", "frames", "image_scale", "points")}
    carve_key = _key(inputs, fingerprint(capture, MATTE_PATTERNS), selection)
    if train.refine.cameras:
        carve_key = _key(carve_key, {name: training["refine"][name] for name in ADJUSTED_BY})
        stages.run(
            "cameras",
            carve_key,
            lambda: adjust_run_cameras(capture, run, train, track, log),
            run / CALIBRATION / START,
            lambda: _remove(run),
        )
    stages.run(
        "carve",
        carve_key,
        lambda: carve_run(capture, run, train, track, settings.workers),
        run / "hull",
        lambda: _remove(run, keep=(CALIBRATION,) if train.refine.cameras else ()),
    )
    if train.scene == "full":
        stages.run(
            "background",
            _key(carve_key, train.seed, *(training["background"][name] for name in DECIDING)),
            lambda: seed_run(capture, run, train, settings.workers, track, log),
            run / BACKGROUND / POINTS,
            lambda: _remove(run / BACKGROUND),
        )
    return carve_key


def fingerprint(capture: Path, patterns: Sequence[str] = INPUT_PATTERNS) -> str:
    """A key of the files' names, sizes and times; contents are not read."""
    entries = []
    for pattern in patterns:
        for path in sorted(capture.glob(pattern)):
            status = path.stat()
            entries.append(f"{path.relative_to(capture)} {status.st_size} {status.st_mtime_ns}")
    return _key(str(capture.resolve()), *entries)


def _is_usable(capture: Path) -> bool:
    """Whether a folder is a capture as it is, to which mattes can be added where it has none."""
    is_capture = (capture / INTRINSICS_NAME).is_file() and any((capture / name).is_dir() for name in ("images", VIDEOS))
    return is_capture and (bool(camera_folders(capture / "masks")) or os.access(capture, os.W_OK))


def _bring_in(source: Path, capture: Path, console: Console) -> None:
    way = pick_format(None, source)
    console.print(f"{source}: {way.name}, {way.summary}", soft_wrap=True)
    told = console_log(console)
    import_source(
        way,
        source,
        capture,
        ImportOptions(),
        log=told,
        warn=lambda line: told(f"warning: {line}"),
        track=Tracker(console).track,
    )


def _check(capture: Path, track: Track) -> None:
    index_capture(capture, None, track)
    problems = check_capture(capture, track=lambda files: track(files, len(files), "files")).problems
    if problems:
        more = f" (and {len(problems) - 1} more; fourd check lists them)" if len(problems) > 1 else ""
        raise UserError(f"{problems[0]}{more}")


def _train(capture: Path, run: Path, train: TrainConfig, lpips: LPIPS | None, console: Console) -> None:
    opened = open_run(run) if (run / CONFIG_NAME).exists() else create_run(capture, run, train)
    Trainer(opened, lpips, console, replace(opened.config.train)).train()


def _remove(folder: Path, keep: tuple[str, ...] = ()) -> None:
    if not folder.exists():
        return
    for entry in folder.iterdir():
        if entry.name in keep:
            continue
        if entry.is_dir():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def _key(*parts: object) -> str:
    text = "\n".join(part if isinstance(part, str) else json.dumps(part, sort_keys=True, default=str) for part in parts)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
