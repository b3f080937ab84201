"""A trained run with segments. At most two segments are open at the same time."""

from __future__ import annotations

import gc
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.reconstruction.training.cameras.rig import Rig
from fourd.reconstruction.training.evaluation.render import RenderedView, render_view
from fourd.reconstruction.training.rendering import RenderablePoints, concatenate
from fourd.reconstruction.training.run import Run, TrainedRun, load_models, load_run, open_run
from fourd.reconstruction.training.run_layout import CHECKPOINTS, checkpoint_files, segment_folder
from fourd.reconstruction.training.segments.fade import kept_points
from fourd.reconstruction.training.segments.plan import SegmentPlan


@dataclass(frozen=True)
class SegmentFrame:
    """A frame of a run, and one segment that contains it.

    Attributes:
        trained: the segment, which is itself a run, with its models and points.
        frame: index of the frame in the segment.
        share: fraction of its points that the segment contributes to the frame, in (0, 1]. The shares of all segments
            of a frame sum to 1.
        is_first: whether the segment is the frame's first segment.
    """

    trained: TrainedRun
    frame: int
    share: float
    is_first: bool

    def kept(self, count: int) -> NDArray[np.int64]:
        """Return the indices of the points that the segment contributes to the frame. ``count`` is the number of the
        segment's points in this frame."""
        return kept_points(count, self.share, is_first=self.is_first)


class SegmentedRun:
    """A run with segments. A segment is loaded when one of its frames is needed. Only the segments of the last
    requested frame stay loaded, so memory use does not grow with the number of segments.

    Attributes:
        run: the whole run, which contains no model, because each segment has its own model.
        plan: the frames of each segment.
    """

    def __init__(self, run: Run) -> None:
        """Check that each segment has a checkpoint. Raises UserError for a segment that was not trained."""
        assert run.config.train.segments.frames is not None, "expected a run with segments"
        self.run = run
        self.plan = SegmentPlan.divide(run.capture.frame_count, run.config.train.segments)
        self._open: dict[int, TrainedRun] = {}
        for index, frames in enumerate(self.plan.ranges):
            folder = segment_folder(run.folder, index)
            if not checkpoint_files(folder / CHECKPOINTS):
                raise UserError(
                    f"{folder}: expected the trained segment of the frames {frames.start} to {frames.stop - 1}, got no "
                    "checkpoint; continue with fourd train --resume"
                )

    @property
    def step(self) -> int:
        """Number of training steps of the first segment."""
        return self.segment(0).step

    @property
    def rig(self) -> Rig:
        """The cameras of the capture. Runs with segments do not correct cameras."""
        return Rig(self.run.capture.cameras)

    def segment(self, index: int) -> TrainedRun:
        """Return the segment with the index ``index``, loaded from its newest checkpoint."""
        if index not in self._open:
            self._open[index] = load_run(segment_folder(self.run.folder, index))
        return self._open[index]

    def at(self, frame: int) -> tuple[SegmentFrame, ...]:
        """Return the one or two segments that contain a frame."""
        shares = self.plan.shares(frame)
        self._close_all_except({index for index, _ in shares})
        return tuple(
            SegmentFrame(self.segment(index), frame - self.plan.ranges[index].start, share, is_first=place == 0)
            for place, (index, share) in enumerate(shares)
        )

    def render(self, frame: int, camera: Camera, layers: int, exclude: int | None = None) -> RenderedView:
        """Render a frame. The arguments have the same meaning as in :meth:`ModelRenderer.render`."""
        clouds = [_evaluate(part, camera, exclude) for part in self.at(frame)]
        config = self.run.config
        return render_view([concatenate(clouds)], camera, layers, config.scene.near, config.train.pixel_filter)

    def close(self) -> None:
        """Close the capture and all segments."""
        self._close_all_except(set())
        self.run.capture.close()

    def _close_all_except(self, kept: set[int]) -> None:
        closed = [index for index in self._open if index not in kept]
        for index in closed:
            self._open.pop(index).close()
        if closed:
            # A segment's objects refer to each other in cycles, so without this call, Python would free their memory
            # only in its next full garbage collection.
            gc.collect()


def open_trained(folder: Path) -> TrainedRun | SegmentedRun:
    """Open a trained run, with or without segments.

    Raises UserError if the run is missing or was not trained.
    """
    run = open_run(folder)
    return SegmentedRun(run) if run.has_segments else load_models(run)


def _evaluate(part: SegmentFrame, camera: Camera, exclude: int | None) -> RenderablePoints:
    """Evaluate the points that a segment contributes to a frame, as seen by ``camera``."""
    (points,) = part.trained.renderer.evaluate(part.trained.frames.get(part.frame), part.frame, camera, exclude)
    rows = part.kept(points.xyz.shape[0])
    return RenderablePoints(points.xyz[rows], points.radius[rows], points.density[rows], points.colour[rows])
