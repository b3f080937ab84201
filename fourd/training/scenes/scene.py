"""The interface of a scene: everything in training and rendering that differs between objects and full scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from fourd.cameras import Camera
from fourd.model import PointModel
from fourd.model.point_model import EvaluatedPoints
from fourd.model.sources import SourceViews
from fourd.training.background import StaticBackground
from fourd.training.cameras.refinement import Refinement
from fourd.training.cameras.rig import Rig
from fourd.training.losses.lpips import LPIPS
from fourd.training.losses.term import LossTerm
from fourd.training.points.frame_points import FramePoints
from fourd.training.rendering import RenderablePoints
from fourd.training.schedule import StepSample
from fourd.training.views import View, ViewStore


@dataclass(frozen=True)
class Target:
    """The picture that a step is trained on.

    Attributes:
        camera: of the rendered part of the picture.
        rgb: (H, W, 3) in [0, 1], premultiplied by ``known``.
        matte: (H, W) alpha of the foreground; None where the target is a plate.
        known: (H, W) where ``rgb`` is known: an object's matte, a whole picture, or the seen part of a plate.
        fills_picture: whether the scene fills the picture. If so, pixels that are not known are excluded from the
            loss; otherwise they show the background colour.
    """

    camera: Camera
    rgb: Tensor
    matte: Tensor | None
    known: Tensor
    fills_picture: bool


@dataclass(frozen=True)
class OptimizedPoints:
    """The M visible points of one cloud in a step, evaluated for the target camera.

    Attributes:
        cloud: the whole cloud.
        rows: (M,) indices of the visible points.
        parameters: their optimised tensors by name, leaves that gather gradients.
        evaluated: geometry and features.
        colour: (M, 3) RGB.
        sources: the source views of the colours; None without image-based colour.
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
    """An object or a full scene."""

    @property
    def models(self) -> Mapping[str, PointModel]:
        """All models by the prefix of their tensors in checkpoints, the foreground's first."""

    @property
    def static_clouds(self) -> Mapping[str, FramePoints]:
        """Points that all frames share, by the name of their file in checkpoints."""

    @property
    def views(self) -> ViewStore:
        """The training pictures."""

    @property
    def background(self) -> StaticBackground | None:
        """The static background; None of an object."""

    @property
    def resident_bytes(self) -> int:
        """Target for the process's resident size while training."""

    def loss_terms(self, lpips: LPIPS | None, refinement: Refinement | None) -> tuple[LossTerm, ...]:
        """Terms of the training loss."""

    def set_rig(self, rig: Rig) -> None:
        """Replace the cameras of views and plates."""

    def target(self, sample: StepSample) -> Target:
        """The picture that a step is trained on."""

    def evaluate_step(
        self, points: FramePoints, time: float, sample: StepSample, camera: Camera, step: int
    ) -> list[OptimizedPoints]:
        """The visible points of the clouds in a step's picture; the foreground's are first."""

    def xyz_rate(self, points: OptimizedPoints, factor: float) -> float | Tensor:
        """Learning rate of the positions in world units, one or (M, 1); ``factor`` is that of the schedule."""

    def finish_step(self) -> None:
        """Called after each update of the parameters."""

    def densify(self, points: FramePoints, sample: StepSample, spent: float) -> None:
        """Split and remove points after a step, when a round is due. ``spent`` is the spent share of the budget."""

    def clear_caches(self) -> None:
        """Drop what a resumed run does not have."""

    def evaluate_frame(
        self, points: FramePoints, frame: int, camera: Camera, sources: list[int]
    ) -> list[RenderablePoints]:
        """All points of a frame (index into the selection), the foreground's first, colours from ``sources``."""

    def reference_picture(self, view: View) -> NDArray[np.float32]:
        """The true picture (H, W, 3) in [0, 1] that a rendering of a view is compared with."""
