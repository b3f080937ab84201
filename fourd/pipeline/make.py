"""Runs the graph of stages to produce a scene file, or to prepare a run for training."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from fourd.base.errors import UserError, command_line
from fourd.base.files import atomic_path, is_unused, remove_unfinished, remove_unfinished_file, require_suffix
from fourd.base.processes import locked_folder
from fourd.base.storage import Location, StorageUrl, check_writable, upload_changed
from fourd.pipeline.cluster import Cluster
from fourd.pipeline.facts import MaskFacts
from fourd.pipeline.fetch import fetch_stage, fetched_path
from fourd.pipeline.graphs.capture import needs_import
from fourd.pipeline.graphs.plan import describe_plan
from fourd.pipeline.graphs.run import RunRequest, stages_to_first_points
from fourd.pipeline.graphs.scene import CALIBRATION, CAPTURE, REPAIRED, SceneStages
from fourd.pipeline.report.decisions import describe_decisions
from fourd.pipeline.report.summary import RunSummary, summarize_run
from fourd.pipeline.runner import Execute, Runner, run_here
from fourd.pipeline.segments import selected_frames
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.bake import BakeSettings
from fourd.pipeline.stages.cameras.repair import repaired_capture
from fourd.pipeline.stages.train import start_run
from fourd.pipeline.still_scenes import stands_still, still_config
from fourd.pipeline.stored.cache import cache_folder
from fourd.pipeline.stored.rate import rate_stage
from fourd.pipeline.stored.results import StoredResults
from fourd.pipeline.work.folder import RUN
from fourd.reconstruction.training.cameras.selection import with_test_split
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.run import Run
from fourd.reconstruction.training.run_layout import CONFIG_NAME, PREPARATION, SOURCE
from fourd.recording.board_calibration.search import BoardRecording, find_board_recording
from fourd.recording.capture import open_capture
from fourd.recording.capture.frame_rate import set_rate
from fourd.recording.capture.layout import DERIVED, MATTES
from fourd.recording.importing.importer import ImportOptions
from fourd.recording.matting.sequence import MatteSettings, chosen_method, forget_choice
from fourd.recording.soundtrack.choice import AUTO
from fourd.scene.packing.report import PackSettings

RECORD = "stages.json"
SCENE = "scene.4dv"
"""Name of the scene file in the folder for intermediate results, if this folder is in an object store. From there, the
finished file is copied to the path or URL of the option -o."""
UPLOADED = "uploaded.json"
"""File that records the last upload: the states of the local scene file and of the object in the store."""


@dataclass(frozen=True)
class MatteChoice:
    """Settings of the mattes. If ``keep_chosen`` is true, mattes whose method the user chose with ``fourd matte`` are
    kept."""

    settings: MatteSettings
    keep_chosen: bool = False


@dataclass(frozen=True)
class WrittenFiles:
    """What the stages so far have found, read from the files that they have written; see
    :class:`fourd.pipeline.graphs.scene.Look`.

    Attributes:
        choice: settings of the mattes.
        context: console on which decisions are printed.
        held: locks of the capture's folder, which are released when all stages have finished.
    """

    choice: MatteChoice
    context: Context
    held: ExitStack

    def board(self, source: Path) -> BoardRecording | None:
        return find_board_recording(source, self.context.log)

    def require_frames(self, capture: Path, train: TrainConfig) -> None:
        views = None if train.views is None else list(train.views)
        open_capture(capture, views=views, frames=train.frames, mattes=False).close()

    def held_out(self, train: TrainConfig, capture: Path) -> TrainConfig:
        return with_test_split(train, capture, self.context.log)

    def repaired(self, capture: Path, repaired: Path) -> Path:
        return repaired_capture(capture, repaired)

    def still(self, capture: Path, train: TrainConfig) -> TrainConfig | None:
        return still_config(train, capture, self.context.log) if stands_still(capture, train) else None

    def masks(self, capture: Path) -> MaskFacts:
        return MaskFacts.read(capture)

    def mattes(self, capture: Path, masks: MaskFacts, train: TrainConfig) -> MatteSettings | None:
        # The capture's folder .fourd/ is locked only if a camera lacks masks from the user. Otherwise, no mattes are
        # written, and the capture may be on a read-only disk.
        if masks.lacks_masks(train.views):
            self.held.enter_context(locked_folder(capture / DERIVED))
        keep = self.choice.keep_chosen
        method = chosen_method(capture) if keep and masks.lacks_masks() else None
        if method is None:
            if not keep:
                forget_choice(capture)
            return self.choice.settings
        made = command_line("fourd", "matte", "--method", method)
        self.context.log(f"{capture / MATTES}: keeping the mattes of {made}; add --method to make others")
        return None

    def frame_numbers(self, capture: Path, train: TrainConfig) -> Sequence[int]:
        return selected_frames(capture, train)


@dataclass(frozen=True)
class SceneRequest:
    """The arguments of :func:`make_scene` that do not depend on the folder for intermediate results. The field ``run``
    does not yet have the paths of the capture and of the run.
    """

    source: Location
    out: Location
    run: RunRequest
    mattes: MatteChoice
    imports: ImportOptions
    pack: PackSettings | None
    sound: str
    context: Context


def make_scene(
    source: Location,
    out: Location,
    train: TrainConfig,
    mattes: MatteSettings,
    context: Context,
    *,
    points_from: Path | None = None,
    lpips_weights: Path | None = None,
    imports: ImportOptions | None = None,
    pack: PackSettings | None = None,
    sound: str = AUTO,
    accept_mattes: bool = False,
    keep_chosen_mattes: bool = False,
    cluster: Cluster | None = None,
    work: Location | None = None,
    force: bool = False,
) -> RunSummary:
    """Run every stage from ``source`` to the scene file ``out``.

    Intermediate results are kept in the folder ``work``: the run (``run/``), the record of the stages
    (``stages.json``), and, if they are made, the imported capture (``capture/``) and the corrected one (``repaired/``).
    After a change of an input or a setting, the next call repeats only the stages that depend on it. Interrupted stages
    resume. A trained run that other settings would replace is kept as ``run.1`` and so on; in a store, it is an error.

    Args:
        source: a capture, or a source that ``fourd import`` can read. A URL is copied to ``work/source/``.
        out: the .4dv file to write. If it is a URL, the file is written in ``work`` and then uploaded.
        train: the training config.
        mattes: settings of the mattes. Mattes are made only if the capture has no masks.
        context: console, and number of processes.
        points_from: folder with the user's points as FRAME.ply files, which replace the carved points.
        lpips_weights: the weights of LPIPS; see :func:`~fourd.reconstruction.training.losses.lpips.load_lpips`.
        imports: options of the import. If ``source`` is a capture, their frame rate, if any, is stored in it.
        pack: how the scene file is compressed, or None for plain arrays.
        sound: see :func:`~fourd.recording.soundtrack.choice.choose_sound`.
        accept_mattes: whether to carve even if the hull covers less than a third of the mattes' area.
        keep_chosen_mattes: whether to keep mattes whose method the user chose with ``fourd matte``.
        cluster: the cluster on which the stages run. If None, the stages run in this process.
        work: the folder for intermediate results. If None, it has the name of ``out`` with the suffix ``.work``, and is
            beside ``out``, or in the current folder if ``out`` is a URL. If ``work`` is a URL, each machine works in a
            local copy and publishes the results of each stage; see :mod:`fourd.pipeline.stored`.
        force: whether to remove trained runs that other settings replace.

    Returns the measured quality of the run, and warnings about it.

    Raises:
        UserError: if the input is invalid, a store refuses a request, or ``work`` has other files or another scene.
    """
    require_suffix(out, (".4dv",), "a scene")
    run = RunRequest(Path(), Path(), train, points_from, lpips_weights, accept_mattes=accept_mattes)
    choice = MatteChoice(mattes, keep_chosen_mattes)
    request = SceneRequest(source, out, run, choice, imports or ImportOptions(), pack, sound, context)
    execute = run_here if cluster is None else cluster.execute
    if isinstance(work, StorageUrl):
        return _make_stored(request, work, execute, is_parallel=cluster is not None, force=force)
    folder = _work_folder(out, work)
    with locked_folder(folder):
        runner = Runner(context, folder / RECORD, execute, is_parallel=cluster is not None, force=force)
        return _make_in_folder(request, folder, runner)


def _make_in_folder(request: SceneRequest, folder: Path, runner: Runner) -> RunSummary:
    """Run the stages of :func:`make_scene` in the local ``folder``, which is locked."""
    if isinstance(request.out, StorageUrl):
        check_writable(request.out)
    folder.mkdir(parents=True, exist_ok=True)
    remove_unfinished(folder, deep=True)
    runner.claim(request.out)
    given, out = _local_source(request.source, folder, runner), request.out
    scene = out if isinstance(out, Path) else folder / out.name
    _run_graph(request, replace(request.run, capture=given, run=folder / RUN), folder, scene, runner)
    if isinstance(out, StorageUrl):
        upload_changed(scene, out, folder / UPLOADED, request.context.track)
    return _summarize(folder)


def _make_stored(
    request: SceneRequest, url: StorageUrl, execute: Execute, *, is_parallel: bool, force: bool
) -> RunSummary:
    """Run the stages of :func:`make_scene`, and store the results at ``url``. The stages work in a local copy of
    ``url``, whose path can differ between machines. Paths of inputs must be valid on every machine, so relative paths
    of the source, the user's points and the LPIPS weights are made absolute."""
    if is_parallel and url.scheme == "memory":
        raise UserError(f"{url}: expected a store that all nodes can reach, got the memory of this process; use s3://")
    out, context, given = request.out, request.context, request.run
    if isinstance(out, StorageUrl):
        check_writable(out)
    root = cache_folder(url)
    with locked_folder(root):
        remove_unfinished(root, deep=True)
        stored = StoredResults(url, request.source, context, force=force)
        runner = Runner(context, None, execute, is_parallel=is_parallel, stored=stored)
        background = replace(given.train.background, seeds=_absolute(given.train.background.seeds))
        run = replace(
            given,
            train=replace(given.train, background=background),
            capture=stored.source(),
            run=root / RUN,
            points_from=_absolute(given.points_from),
            lpips_weights=_absolute(given.lpips_weights),
        )
        scene = root / SCENE
        _run_graph(request, run, root, scene, runner)
        stored.remove_others()
        if isinstance(out, StorageUrl):
            upload_changed(scene, out, root / UPLOADED, context.track)
        else:
            remove_unfinished_file(out)
            _copy_changed(scene, out)
        return _summarize(root)


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.absolute()


def _absolute_name(sound: str) -> str:
    """Return the absolute path if the value of --sound is a file, because other machines have other folders."""
    return str(Path(sound).absolute()) if Path(sound).is_file() else sound


def _copy_changed(source: Path, target: Path) -> None:
    """Copy a file, unless the target already has the same size and modification time."""
    status = source.stat()
    if target.is_file():
        before = target.stat()
        if (before.st_size, before.st_mtime_ns) == (status.st_size, status.st_mtime_ns):
            return
    with atomic_path(target) as temporary:
        shutil.copyfile(source, temporary)
        os.utime(temporary, ns=(status.st_atime_ns, status.st_mtime_ns))


def _local_source(source: Location, work: Path, runner: Runner) -> Path:
    """Return the local path of the source. If it is a URL, first copy the source into the folder ``work``."""
    if isinstance(source, Path):
        return source
    runner.run([fetch_stage(source, work / SOURCE)])
    return fetched_path(source, work / SOURCE)


def _run_graph(request: SceneRequest, run: RunRequest, work: Path, out: Path, runner: Runner) -> None:
    """Run the stages of :func:`make_scene` in the locked folder for intermediate results. ``run.capture`` is the path
    of the input, which may need an import. ``out`` is a local file."""
    given, options, context = run.capture, request.imports, request.context
    stages = SceneStages(
        given,
        run,
        options,
        work,
        out,
        BakeSettings(pack=request.pack, sound=_absolute_name(request.sound)),
        # In a store, the key of the import must not depend on the path of this machine's copy.
        finds_board=not runner.is_stored,
        from_hull=request.mattes.keep_chosen,
    )
    remove_unfinished_file(out)
    context.log(describe_plan(stages, context.workers))
    if options.fps is not None and not needs_import(given, options):
        if given.is_relative_to(work) and runner.is_stored:
            runner.run((rate_stage(given, options.fps),))
        else:
            set_rate(given, options.fps)
    with ExitStack() as held:
        for group in stages.groups(WrittenFiles(request.mattes, context, held)):
            runner.run(group)


def _summarize(work: Path) -> RunSummary:
    """Return the quality of the run in the folder for intermediate results, and what was decided on the way."""
    decisions = describe_decisions(work / CALIBRATION, work / CAPTURE, work / REPAIRED, work / RUN)
    return replace(summarize_run(work / RUN), decisions=decisions)


def _work_folder(out: Location, given: Path | None) -> Path:
    """Return the folder for the intermediate results of ``out``. Raises UserError if it contains files and was not
    created by ``fourd make``."""
    local = out if isinstance(out, Path) else Path(out.name)
    work = local.with_suffix(".work") if given is None else given
    if not (work / RECORD).exists() and not is_unused(work):
        raise UserError(
            f"{work}: expected a folder made by fourd make, got a folder with other files; move it or choose another "
            "-o or --work"
        )
    return work


def create_run(
    capture: Path, folder: Path, train: TrainConfig, points_from: Path | None = None, context: Context | None = None
) -> Run:
    """Run all stages that precede training, and write the run's config.yaml. Repeat an interrupted call to resume it.

    Args:
        capture: the capture's folder, with masks or mattes.
        folder: the run folder, which must be new, empty, or left by an interrupted call.
        train: the training config.
        points_from: folder with the user's points as FRAME.ply files, which replace the carved points.
        context: console, and number of processes. If None, the stages use one process and print nothing.

    Raises:
        UserError: if the input is invalid, or if ``folder`` is already a run or contains files that are not from an
            earlier call.
    """
    require_new_run(folder)
    context = context or Context()
    train = with_test_split(train, capture, context.log)
    Runner(context).run(stages_to_first_points(RunRequest(capture, folder, train, points_from)))
    return start_run(capture, folder, train)


def require_new_run(folder: Path) -> None:
    """Raise UserError if training cannot start in ``folder``."""
    if (folder / CONFIG_NAME).exists():
        raise UserError(
            f"{folder}: expected a new folder, got a run; add --resume to continue the run, or name another folder"
        )
    if folder.exists() and (not folder.is_dir() or any(entry.name not in PREPARATION for entry in folder.iterdir())):
        raise UserError(f"{folder}: expected a new or empty folder, got other files; name another folder with --out")
