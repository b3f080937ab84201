"""The training loop: steps, progress, validation, checkpoints and resuming."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from safetensors import SafetensorError
from safetensors.torch import save_file

from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.base.formats.picture import write_picture
from fourd.base.processes import DeferredInterrupt
from fourd.base.progress import format_minutes
from fourd.reconstruction.training.cameras.calibration import write_corrected
from fourd.reconstruction.training.checkpoints import (
    SavedProgress,
    checkpoint_path,
    latest_checkpoint,
    load_checkpoint,
    pack_optimizer,
    restore,
    save_checkpoint,
    unpack_optimizer,
)
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.distributed.process_group import ALONE, ProcessGroup
from fourd.reconstruction.training.evaluation.held_out_views import HeldOutViews
from fourd.reconstruction.training.evaluation.render import ModelRenderer
from fourd.reconstruction.training.evaluation.scores import score_view
from fourd.reconstruction.training.live.session import CONTROL_SECONDS, LiveSession, NoSession, StepCount
from fourd.reconstruction.training.losses.lpips import LPIPS
from fourd.reconstruction.training.memory import HeapTrimmer, retain_freed_memory
from fourd.reconstruction.training.metrics_log import MetricsLog, NoLog
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.frame_store import file_name
from fourd.reconstruction.training.run import Run, drop_stale_points
from fourd.reconstruction.training.run_layout import VALIDATION, points_folder
from fourd.reconstruction.training.scenes.build import build_scene
from fourd.reconstruction.training.scenes.preparation import StepPreparation
from fourd.reconstruction.training.schedule import StepSample, StepSampler, budget_spent, rate_factor
from fourd.reconstruction.training.step import Stepper, StepResult
from fourd.rendering.ops.gpu import CPU

LOG_INTERVAL = 10
"""Number of steps between two records of metrics."""
PSNR_SMOOTHING = 0.97
"""Weight of the previous value in the exponential moving average of the PSNR."""
MAX_VALIDATION_VIEWS = 4


@dataclass(frozen=True)
class TrainSummary:
    """State or result of a training run: number of steps, training time in seconds, and smoothed PSNR of the training
    views in dB."""

    steps: int
    seconds: float
    psnr: float


OnStep = Callable[[TrainSummary], object]
"""A function that is called after each training step."""


class Trainer:
    """Trains a run until its budget is spent, starting from its newest checkpoint if there is one."""

    def __init__(
        self,
        run: Run,
        lpips: LPIPS | None,
        console: Console,
        budget: TrainConfig,
        group: ProcessGroup = ALONE,
        device: torch.device = CPU,
    ) -> None:
        """Load the run's newest checkpoint, if there is one.

        Args:
            run: the run folder.
            lpips: the network of the perceptual loss; if None, SSIM replaces the perceptual loss.
            console: console that shows the progress of training.
            budget: the run's config, but with the limits max_steps and max_seconds for this training. When a run is
                resumed, these limits may be larger than the limits in config.yaml.
            group: the ranks that train the run together.
            device: device on which the scene is trained. Checkpoints do not depend on the device.
        """
        if budget.max_steps is None and budget.max_seconds is None:
            raise UserError("--max-steps, --max-seconds: expected at least one of them, got neither; set a limit")
        self.run = run
        self.config = budget
        self.console = console
        self.group = group
        model = run.new_model()
        found, note = latest_checkpoint(run.checkpoints)
        if note:
            console.print(note, style="yellow")
        saved = None if found is None else points_folder(found)
        background = run.background(saved)
        self.scene = build_scene(budget, model, run.view_store(device), background, run.config.scene.near)
        self.refinement = run.new_refinement()
        self.preparation = StepPreparation(self.scene)
        self.stepper = Stepper(self.scene, budget, lpips if lpips is None else lpips.to(device), self.refinement, group)
        self.done = 0
        self.seconds = 0.0
        self.psnr = 0.0
        if found is not None:
            self._restore(found)
        self.held_out = HeldOutViews(run, run.config.train, self.done, is_warm=found is not None and self.done == 0)
        cameras, frames = run.capture.cameras, run.capture.frame_count
        self.sampler = StepSampler(budget, cameras, self.held_out.training, frames, run.focus, group)
        group.broadcast_parameters(self.stepper.dense_parameters)
        if group.is_first:
            drop_stale_points(run.checkpoints)
        self.frames = run.frame_store(saved, device)
        self.renderer = ModelRenderer(self.scene, self.held_out.training, run.focus, run.config.train.pixel_filter)
        self._saved_step = self.done if saved is not None else -1

    def train(self, on_step: OnStep | None = None) -> TrainSummary:
        """Train until the budget is spent. ``on_step`` is called after each training step, outside the time budget.

        Ctrl-C is handled after the current training step, so that the checkpoint never contains a half-finished step. A
        second Ctrl-C ends training at once, without a new checkpoint. Between steps, the loop also handles requests
        from ``fourd serve`` to pause, save or stop.
        """
        retain_freed_memory()
        log = MetricsLog(self.run.folder, resume_step=self.done) if self.group.is_first else NoLog()
        try:
            if self.group.is_first:
                self.held_out.save()
            with self._progress() as progress, self._session() as session:
                task = progress.add_task("train", total=1.0, note="")
                show = partial(progress.update, task)
                with DeferredInterrupt() as interrupt:
                    self._loop(log, lambda note: show(completed=self._spent(), note=note), interrupt, session, on_step)
                log.close()
                self._checkpoint()
                if self.group.is_first and self.held_out.is_test_due(self.done):
                    self._measure_held_out()
        finally:
            log.close()
        return TrainSummary(self.done, self.seconds, self.psnr)

    def _loop(
        self,
        log: MetricsLog | NoLog,
        show: Callable[[str], None],
        interrupt: DeferredInterrupt,
        session: LiveSession | NoSession,
        on_step: OnStep | None,
    ) -> None:
        trimmer = HeapTrimmer(self.scene.resident_bytes)
        last_save, last_validation = self.seconds, self.seconds
        session.show(self._count())
        while self._spent() < 1.0:
            started = time.monotonic()
            self._step(log)
            trimmer.after_step()
            self.seconds += self.group.longest(time.monotonic() - started)
            show(self._describe())
            if on_step is not None:
                on_step(TrainSummary(self.done, self.seconds, self.psnr))
            if self.held_out.is_release_due(self._spent()):
                trimmer.trim()
                self._release_camera()
            if self._is_checkpoint_due(self.seconds - last_save):
                trimmer.trim()
                self._checkpoint()
                last_save = self.seconds
            if self.seconds - last_validation >= self.config.validation_seconds:
                trimmer.trim()
                if self.group.is_first:
                    self._validate(log)
                last_validation = self.seconds
            session.show(self._count())
            session.look()
            if self.group.any(interrupt.is_pending or session.wanted is not None):
                self._checkpoint()
                self._answer(session, interrupt, show)

    def _release_camera(self) -> None:
        """Measure the held-out score of the camera that was left out, and train on it from now on. The score is written
        before the next checkpoint, so a run that resumes from this checkpoint finds it."""
        if self.group.is_first:
            self._measure_held_out()
        self.held_out.release()
        self.sampler.use(self.held_out.training)
        self.renderer.training = self.held_out.training

    def _measure_held_out(self) -> None:
        frames = self.group.own_frames(self.run.capture.frame_count)
        score = self.held_out.measure(self.renderer, self.frames.get, frames, self.seconds)
        self.held_out.score = replace(score, step=self.done)
        self.held_out.save()
        # The number of measured images depends on the time that they take. Training must not depend on it.
        self.scene.clear_caches()

    def _answer(
        self, session: LiveSession | NoSession, interrupt: DeferredInterrupt, show: Callable[[str], None]
    ) -> None:
        """Pause, continue or end training, as requested. All ranks call this method after they have saved a
        checkpoint."""
        is_paused = False
        while True:
            if self.group.any(interrupt.is_pending or session.wanted == "stop"):
                if session.wanted == "stop":
                    self._say(f"stopped by fourd serve, saved at step {self.done}")
                raise KeyboardInterrupt
            if self.group.any(session.wanted == "pause") and not is_paused:
                is_paused = True
                self._say(f"paused by fourd serve, saved at step {self.done}; Ctrl-C ends the training")
                show(f"paused at step {self.done}")
            elif self.group.any(session.wanted == "resume") and is_paused:
                is_paused = False
                self._say(f"resumed at step {self.done}")
            session.answered()
            if not is_paused:
                return
            session.show(self._count(), "paused")
            time.sleep(CONTROL_SECONDS)
            session.look()

    def _say(self, line: str) -> None:
        if self.group.is_first:
            self.console.print(f"{self.run.folder}: {line}", soft_wrap=True, markup=False, highlight=False)

    def run_step(self, number: int, factor: float) -> tuple[StepSample, FramePoints, StepResult]:
        """Perform the step with this number, with all learning rates multiplied by ``factor``. Meanwhile, another
        thread prepares the next step. Returns the sample, the points and the result of the step."""
        sample = self.sampler.sample(number)
        points = self.frames.get(sample.frame)
        prepared = self.preparation.take(sample) or self.scene.prepare(points, sample)
        following = self.sampler.sample(number + self.group.size)
        ahead = None if following.frame == sample.frame else self.frames.prepare(following.frame)
        # A refinement changes the cameras of all views in each step.
        if ahead is not None and self.refinement is None:
            self.preparation.start(following, ahead)
        update, frame_time = number // self.group.size, self.run.capture.time(sample.frame)
        result = self.stepper.step(points, frame_time, sample, factor, prepared, update)
        self.preparation.settle()
        return sample, points, result

    def _step(self, log: MetricsLog | NoLog) -> None:
        factor = rate_factor(self.config.rates, self.done, self._spent())
        sample, points, result = self.run_step(self.done, factor)
        self.scene.densify(points, sample, self._spent())
        self.psnr = result.psnr if self.done == 0 else PSNR_SMOOTHING * self.psnr + (1 - PSNR_SMOOTHING) * result.psnr
        self.done += self.group.size
        if self._passed(LOG_INTERVAL):
            log.scalars(
                self.done,
                {
                    "psnr": result.psnr,
                    "psnr_smooth": self.psnr,
                    "seconds": self.seconds,
                    "rate_factor": factor,
                    **{f"loss/{name}": value for name, value in result.terms.items()},
                },
            )

    def _validate(self, log: MetricsLog | NoLog) -> None:
        """Log the mean PSNR of held-out views at the middle frame, measured inside the bounding box of each matte. If
        rank 0 does not own the middle frame, the nearest earlier frame of rank 0 is used.

        Training views are used if no view is held out; see :attr:`HeldOutViews.validation`.
        """
        views, name = self.held_out.validation
        frame = self.group.first_ranks_frame(self.run.capture.frame_count // 2)
        points = self.frames.get(frame)
        values = []
        pair = np.zeros((1, 1, 3), np.uint8)
        for index in views[:MAX_VALIDATION_VIEWS]:
            view = self.scene.views.view(index, frame)
            rendered = self.renderer.render(points, frame, view.camera, self.config.layers, exclude=index)
            truth = self.scene.reference_picture(view)
            image, box = score_view(rendered.rgb, truth, view.matte, None)
            values.append((box or image).psnr)
            pair = (np.concatenate([truth, rendered.rgb], axis=1) * 255 + 0.5).astype(np.uint8)
        log.scalars(self.done, {name: float(np.mean(values)), "seconds": self.seconds})
        log.image(self.done, "validation", pair)
        path = self.run.folder / VALIDATION / f"{self.done:07d}.png"
        write_picture(path, np.asarray(cv2.cvtColor(pair, cv2.COLOR_RGB2BGR), np.uint8))

    def _checkpoint(self) -> None:
        """Save the points first and the model file last, because the presence of the model file marks the checkpoint as
        complete. Each rank saves the points of its frames, and rank 0 saves all other data."""
        if self.done == self._saved_step:
            return
        target = checkpoint_path(self.run.checkpoints, self.done)
        self._save_points(points_folder(target))
        if self.group.is_first:
            self._save_models()
        self.group.barrier()
        self.scene.clear_caches()
        self._saved_step = self.done

    def _save_models(self) -> None:
        """Save the models, the optimizer and the state."""
        models = self.scene.models.items()
        tensors = {f"{prefix}.{name}": value for prefix, model in models for name, value in model.state_dict().items()}
        if self.refinement is not None:
            tensors.update({f"refinement.{name}": value for name, value in self.refinement.state_dict().items()})
        tensors.update(pack_optimizer(self.stepper.optimizer, "optimizer."))
        state = SavedProgress(self.seconds, self.psnr).to_json()
        on_cpu = {name: value.cpu() for name, value in tensors.items()}
        save_checkpoint(self.run.checkpoints, self.done, on_cpu, state)
        drop_stale_points(self.run.checkpoints)
        if self.refinement is not None:
            write_corrected(self.run.folder, self.run.capture, self.refinement.rig())

    def _save_points(self, folder: Path) -> None:
        is_first, count = self.group.is_first, self.run.capture.frame_count
        # The folder may remain from an earlier, damaged checkpoint of the same step. Atomic writing replaces only
        # regular files, so the folder is removed if it contains anything else, such as a named pipe or a subfolder.
        if is_first and any(path.is_symlink() or not path.is_file() for path in folder.glob("*")):
            shutil.rmtree(folder)
        self.group.barrier()
        try:
            self.frames.save(folder, self.group.own_frames(count))
            for name, cloud in self.scene.static_clouds.items() if is_first else ():
                with atomic_path(folder / f"{name}.safetensors") as temporary:
                    save_file(cloud.tensors(), temporary)
        except (OSError, SafetensorError) as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise UserError(
                f"{folder}: expected free disk space for a checkpoint, got '{error}'; "
                f"the previous checkpoint is intact: free some space and add --resume"
            ) from error
        self.group.barrier()
        for frame in range(count) if is_first else ():
            file = folder / file_name(frame)
            if not file.exists():
                raise UserError(
                    f"{file}: expected the points from rank {frame % self.group.size}, got no such file; put the run "
                    "on storage that the machines of all ranks share"
                )

    def _restore(self, found: Path) -> None:
        """Load the models, the optimizer and the state from the checkpoint ``found``."""
        self.done, tensors, state = load_checkpoint(found)
        for prefix, model in self.scene.models.items():
            restore(model, tensors, f"{prefix}.", found)
        if self.refinement is not None:
            restore(self.refinement, tensors, "refinement.", found)
            self.stepper.update_cameras()
        unpack_optimizer(self.stepper.optimizer, tensors, "optimizer.", found)
        progress = SavedProgress.from_json(state, found)
        self.seconds, self.psnr = progress.seconds, progress.psnr

    def _session(self) -> LiveSession | NoSession:
        if not self.group.is_first:
            return NoSession()
        return LiveSession(self.run.folder, self.config.max_steps, self.held_out.exist, self.console)

    def _count(self) -> StepCount:
        return StepCount(self.done, self.seconds, self._spent())

    def _describe(self) -> str:
        """Return the state of training for the progress bar, such as "step 301, 32.0 dB on training views, 5:31 of
        10:00"."""
        of_steps = "" if self.config.max_steps is None else f" of {self.config.max_steps}"
        seconds = self.config.max_seconds
        of_time = "" if seconds is None else f", {format_minutes(self.seconds)} of {format_minutes(seconds)}"
        return f"step {self.done}{of_steps}, {self.psnr:.1f} dB on training views{of_time}"

    def _spent(self) -> float:
        return budget_spent(self.config, self.done, self.seconds)

    def _is_checkpoint_due(self, seconds: float) -> bool:
        if self.config.checkpoint_steps is not None:
            return self._passed(self.config.checkpoint_steps)
        return seconds >= self.config.checkpoint_seconds

    def _passed(self, interval: int) -> bool:
        """Return true if the step count reached a multiple of ``interval`` in the last update. An update counts as one
        step per rank."""
        return self.done // interval > (self.done - self.group.size) // interval

    def _progress(self) -> Progress:
        return Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f}%  {task.fields[note]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self.console,
            disable=self.console.quiet,
        )
