"""Preparation of the next training step on another thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait

import torch

from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.scenes.scene import PreparedStep, TrainingScene
from fourd.reconstruction.training.schedule import StepSample
from fourd.rendering.ops.loading import thread_count

THREADS_PER_STEP = 4
"""One of this number of threads prepares the next step, but at least one. Preparation takes an eighth of a step's CPU
time."""


class StepPreparation:
    """Prepares the next step while the current step computes.

    A step computes some parts with one thread only, and meanwhile the other cores prepare the next step: they decode
    and convert images, and render the depths that decide occlusion. All of this is determined by stored points, so the
    result is the same as if the step prepared itself.
    """

    def __init__(self, scene: TrainingScene) -> None:
        self._scene = scene
        self._worker = ThreadPoolExecutor(1, "preparation")
        self._ahead: tuple[StepSample, Future[PreparedStep]] | None = None

    def start(self, sample: StepSample, points: Callable[[], FramePoints]) -> None:
        """Start to prepare a step, unless there is only one thread. ``points`` returns the points of its frame, which
        must not change before the step, as the images and cameras of the scene must not. Before they are used
        elsewhere, :meth:`settle` must be called."""
        threads = thread_count(0, torch.get_num_threads())
        if threads > 1:
            share = max(1, threads // THREADS_PER_STEP)
            self._ahead = sample, self._worker.submit(lambda: self._scene.prepare(points(), sample, share))

    def take(self, sample: StepSample) -> PreparedStep | None:
        """Return the prepared step with this sample, or None if another step or none was prepared."""
        ahead, self._ahead = self._ahead, None
        return ahead[1].result() if ahead is not None and ahead[0] is sample else None

    def settle(self) -> None:
        """Wait until the step is prepared. An error of the preparation is raised by :meth:`take`."""
        if self._ahead is not None:
            wait([self._ahead[1]])
