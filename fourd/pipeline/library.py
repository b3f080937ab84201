"""The pipeline as two Python functions: :func:`make` and :func:`train`."""

from __future__ import annotations

from pathlib import Path

from fourd.base.progress import Terminal
from fourd.pipeline.graphs.run import RunRequest, stages_to_run
from fourd.pipeline.make import make_scene, require_new_run
from fourd.pipeline.report.summary import RunSummary
from fourd.pipeline.runner import Runner
from fourd.pipeline.stage import Context
from fourd.reconstruction.training.cameras.selection import with_test_split
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.loop import OnStep
from fourd.reconstruction.training.run import Run, open_run
from fourd.recording.importing.importer import ImportOptions
from fourd.recording.matting.sequence import MatteSettings
from fourd.rendering.ops.device_name import DeviceName
from fourd.scene.files.encoding import Tier
from fourd.scene.packing.report import PackSettings


def make(
    source: Path | str,
    out: Path | str,
    config: TrainConfig | None = None,
    *,
    mattes: MatteSettings | None = None,
    imports: ImportOptions | None = None,
    tier: Tier | None = "full",
    workers: int = 1,
    device: DeviceName = "auto",
    quiet: bool = False,
    on_step: OnStep | None = None,
) -> RunSummary:
    """Make a scene file from videos or a capture, as ``fourd make`` does. A repeated call resumes an interrupted one.

    Args:
        source: a capture, or any folder that ``fourd import`` reads.
        out: the .4dv file to write. Intermediate results are kept beside it in a folder with the suffix .work.
        config: the settings of training, among them the cameras, the frames and the budget. If None, the defaults.
        mattes: the settings of matting. If None, the defaults.
        imports: options of the import, among them a calibration. If None, time offsets between videos are estimated,
            and those of high confidence are applied.
        tier: how the scene file is compressed; see ``fourd pack --help``. If None, it contains plain arrays.
        workers: number of processes. With more than one, the caller needs ``if __name__ == "__main__":``, because each
            process imports the main module.
        device: device that trains. "auto" is a GPU if torch and the kernels of fourd can use one, otherwise the CPU.
        quiet: whether to print no progress.
        on_step: function that is called after each training step; see :func:`train`.

    Returns the measured quality of the run, and warnings about it.

    Raises:
        UserError: if the input is invalid, or the folder of intermediate results belongs to something else.
    """
    context = Context(Terminal(quiet=quiet), workers, device=device, on_step=on_step)
    return make_scene(
        Path(source),
        Path(out),
        config or TrainConfig(),
        mattes or MatteSettings(),
        context,
        imports=imports or ImportOptions(sync_if_possible=True),
        pack=None if tier is None else PackSettings(tier),
    )


def train(
    capture: Path | str,
    out: Path | str,
    config: TrainConfig | None = None,
    *,
    workers: int = 1,
    device: DeviceName = "auto",
    quiet: bool = False,
    on_step: OnStep | None = None,
) -> Run:
    """Train a run on a capture with masks or mattes, as ``fourd train`` does.

    Args:
        capture: the capture's folder.
        out: the run's folder, which must be new or empty.
        config: the settings of training. If None, the defaults. A config without ``max_steps`` and ``max_seconds``
            trains until it is interrupted.
        workers: number of processes that prepare the training; see :func:`make`.
        device: device that trains; see :func:`make`.
        quiet: whether to print no progress.
        on_step: function that is called after each training step with the number of steps, the training time in seconds
            and the PSNR of the training views in dB. If it raises an exception, training ends with this exception.

    Returns the trained run: its config, its capture, and its training and held-out cameras.

    Raises:
        UserError: if the capture has neither masks nor mattes, or ``out`` contains other files.
    """
    capture, out = Path(capture), Path(out)
    require_new_run(out)
    context = Context(Terminal(quiet=quiet), workers, device=device, on_step=on_step)
    selected = with_test_split(config or TrainConfig(), capture, context.log)
    Runner(context).run(stages_to_run(RunRequest(capture, out, selected)))
    return open_run(out)
