"""The interface of a scene: everything in training and rendering that differs between object scenes and full scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera, SelectedViews
from fourd.reconstruction.model import PointModel
from fourd.reconstruction.model.point_model import EvaluatedPoints
from fourd.reconstruction.model.sources import SourceViews
from fourd.reconstruction.training.background import StaticBackground
from fourd.reconstruction.training.cameras.refinement import Refinement
from fourd.reconstruction.training.cameras.rig import Rig
from fourd.reconstruction.training.losses.lpips import LPIPS
from fourd.reconstruction.training.losses.term import LossTerm
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.rendering import RenderablePoints
from fourd.reconstruction.training.schedule import StepSample
from fourd.reconstruction.training.views import View, ViewStore


@dataclass(frozen=True)
class Target:
    """The ground-truth image of a training step.

    Attributes:
        camera: camera of the rendered part of the image.
        rgb: (H, W, 3) colours in [0, 1], premultiplied by ``known``.
        matte: (H, W) alpha of the foreground, or None if the target is a plate.
        known: (H, W) mask in [0, 1]: 1 where ``rgb`` is known, 0 where it is unknown. In an object scene, the mask is
            the matte. For a frame of a full scene, the mask is 1 everywhere. For a plate, the mask is 1 where the plate
            shows the background.
        fills_picture: whether the scene covers the whole image. If true, the loss ignores pixels whose colour is
            unknown. If false, they get the step's background colour.
    """

    camera: Camera
    rgb: Tensor
    matte: Tensor | None
    known: Tensor
    fills_picture: bool


@dataclass(frozen=True)
class PreparedStep:
    """The parts of a training step that are determined by images, cameras and the stored points of a frame, and not by
    networks.

    Attributes:
        target: the ground-truth image.
        rows: (M,) indices of the frame's points that are visible in the target's view, or None if the step has no
            foreground, or if other clouds can occlude it.
        sources: the source views of the foreground, with the depths that occlude points; None if the step has no
            foreground, or if its model has no image-based colour.
    """

    target: Target
    rows: Tensor | None = None
    sources: SourceViews | None = None


@dataclass(frozen=True)
class OptimizedPoints:
    """The M points of one cloud that are visible in a step, evaluated for the target camera.

    Attributes:
        cloud: all points of the cloud: the points of a frame, or those of the background.
        rows: (M,) indices of the visible points.
        parameters: name -> optimised tensor of the visible points. Each tensor is an autograd leaf that receives the
            gradient of the loss.
        evaluated: geometry and features of the visible points.
        colour: (M, 3) RGB of the visible points as seen by the target camera.
        sources: the source views from which colours are blended, or None if the model has no image-based colour.
    """

    cloud: FramePoints
    rows: Tensor
    parameters: Mapping[str, Tensor]
    evaluated: EvaluatedPoints
    colour: Tensor
    sources: SourceViews | None

    @property
    def renderable(self) -> RenderablePoints:
        return RenderablePoints.of(self.evaluated, self.colour)


class TrainingScene(Protocol):
    """Interface of both kinds of scenes: object scenes and full scenes."""

    @property
    def models(self) -> Mapping[str, PointModel]:
        """All models, with the foreground's model first. The keys are the prefixes of the models' tensor names in
        checkpoints."""

    @property
    def static_clouds(self) -> Mapping[str, FramePoints]:
        """Point clouds that all frames share. The keys are their file names in checkpoints, without the suffix."""

    @property
    def views(self) -> ViewStore:
        """The store of training images."""

    @property
    def background(self) -> StaticBackground | None:
        """The static background, or None for an object scene."""

    @property
    def near(self) -> float:
        """Depth of the near plane in world units."""

    @property
    def resident_bytes(self) -> int:
        """Target for the process's resident size while training, in bytes."""

    def loss_terms(self, lpips: LPIPS | None, refinement: Refinement | None) -> tuple[LossTerm, ...]:
        """Return the terms of the training loss."""

    def set_rig(self, rig: Rig) -> None:
        """Replace the cameras of views and plates by the corrected cameras of ``rig``."""

    def prepare(self, points: FramePoints, sample: StepSample, threads: int = 0) -> PreparedStep:
        """Prepare a step on the points of a frame with at most ``threads`` CPU threads, or with the default number if
        it is 0. The result does not depend on networks, on the points of other frames or on static clouds."""

    def evaluate_step(
        self, points: FramePoints, time: float, sample: StepSample, prepared: PreparedStep, step: int
    ) -> list[OptimizedPoints]:
        """Evaluate the visible points of each cloud that is rendered in a step, with the foreground first."""

    def xyz_rate(self, points: OptimizedPoints, factor: float) -> Tensor:
        """Return the learning rates (M, 1) of M points' positions, in world units. ``factor`` is the factor by which
        the schedule multiplies all learning rates."""

    def least_depth(self, points: OptimizedPoints) -> float:
        """Return the depth in world units before which a step moves no point of a cloud."""

    def finish_step(self) -> None:
        """Notify the scene that a training step has ended and has updated the parameters."""

    def densify(self, points: FramePoints, sample: StepSample, spent: float) -> None:
        """Split and remove points after a step, if densification is due. ``spent`` is the fraction of the training
        budget that is spent."""

    def clear_caches(self) -> None:
        """Drop cached data. To give the same result as a resumed run, which starts without cached data, an
        uninterrupted run must drop its cached data at each checkpoint."""

    def evaluate_frame(
        self, points: FramePoints, frame: int, camera: Camera, sources: SelectedViews
    ) -> list[RenderablePoints]:
        """Evaluate all points of the scene at one frame, with the foreground first. ``frame`` is an index into the
        selected frames. ``sources`` contains the indices and view weights of the cameras from whose images the colours
        are blended."""

    def reference_picture(self, view: View) -> NDArray[np.float32]:
        """Return the true image (H, W, 3) in [0, 1] with which a rendering of the view is compared."""
