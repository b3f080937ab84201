"""One training step: render a view of a frame, compare, and move everything a little."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.model import PointModel
from fourd.model.sources import SourceViews, project_points
from fourd.raster import point_visibility, render_points
from fourd.raster.arrays import render_points_numpy
from fourd.training.config import TrainConfig
from fourd.training.data import View, ViewStore
from fourd.training.frames import FramePoints
from fourd.training.losses import ImageLoss
from fourd.training.schedule import Choice

NEAR = 0.01
ROWS = 1024


@dataclass(frozen=True)
class StepResult:
    """What a step measured: each term's weighted value, and PSNR in dB of the rendered part."""

    terms: dict[str, float]
    psnr: float


class Stepper:
    """Holds the model and its optimiser; :meth:`step` trains on one view of one frame."""

    def __init__(self, model: PointModel, config: TrainConfig, loss: ImageLoss, views: ViewStore) -> None:
        self.model = model
        self.config = config
        self.loss = loss
        self.views = views
        planes = [p for name, p in model.named_parameters() if "planes" in name]
        others = [p for name, p in model.named_parameters() if "planes" not in name]
        self.optimizer = torch.optim.Adam(
            [
                {"params": planes, "lr": config.rates.planes, "base": config.rates.planes},
                {"params": others, "lr": config.rates.mlps, "base": config.rates.mlps},
            ],
            betas=(0.9, 0.99),
            eps=1e-15,
            fused=True,
        )
        self.scene_size = float((model.upper - model.lower).max())

    def step(self, points: FramePoints, time: float, choice: Choice, factor: float, number: int) -> StepResult:
        """Train once; ``factor`` scales all rates, ``number`` names the step in errors.

        Raises UserError naming the step and the loss's term when a value is not finite; nothing
        is changed then.
        """
        view = self.views.view(choice.target, choice.frame)
        target, matte = view.target()
        rows = self._rows_in_sight(points, view.camera)
        sources = self._sources(points, choice)
        free = {name: value[rows].requires_grad_() for name, value in points.free.items()}
        xyz = free["xyz"]
        features = self.model.point_features(xyz, time)
        radius, density = self.model.geometry(features)
        displacement = self.model.displacement(xyz, time)
        placed = xyz if displacement is None else xyz + displacement
        train_encoder = number % self.config.encoder_every == 0
        colour = self.model.colour(placed, features, view.camera, sources, free.get("sh"), train_encoder=train_encoder)
        render = render_points(placed, colour, radius, density, view.camera, layers=choice.layers, near=NEAR)
        background = torch.from_numpy(choice.background)
        terms = self.loss.terms(render.features, render.alpha, target, matte, background)
        if displacement is not None:
            spacing = self.model.spacing
            terms["residual"] = self.config.loss.residual * (displacement / spacing).square().mean()
        _require_finite(terms, number)
        self._apply(points, rows, free, terms, factor)
        with torch.no_grad():
            if self.config.keep_in_hull:
                keep_in_hull(points, rows, xyz.detach(), self._seen_by(view, sources))
            points.radius[rows], points.density[rows] = radius, density
            error = float((render.features.clamp(0, 1) - target).square().mean())
        psnr = -10 * math.log10(max(error, 1e-10))
        return StepResult({name: float(value.detach()) for name, value in terms.items()}, psnr)

    def _apply(
        self, points: FramePoints, rows: Tensor, free: dict[str, Tensor], terms: dict[str, Tensor], factor: float
    ) -> None:
        torch.stack(list(terms.values())).sum().backward()
        for group in self.optimizer.param_groups:
            group["lr"] = group["base"] * factor
        self.optimizer.step()
        # At once, not before the next: what lives from step to step among what does not splits the heap.
        self.optimizer.zero_grad(set_to_none=True)
        rates = self.config.rates
        gradients = {name: torch.nan_to_num(value.grad) for name, value in free.items() if value.grad is not None}
        with torch.no_grad():
            points.update(rows, gradients, {"xyz": rates.xyz * self.scene_size * factor, "sh": rates.sh * factor})

    def _rows_in_sight(self, points: FramePoints, camera: Camera) -> Tensor:
        if self.config.hidden_weight == 0:
            return torch.arange(points.xyz.shape[0])
        weight = point_visibility(
            points.xyz, points.radius, points.density, camera, layers=self.config.layers, near=NEAR
        )
        return heaviest_rows(weight, self.config.hidden_weight)

    def _seen_by(self, view: View, sources: SourceViews | None) -> list[tuple[Camera, Tensor]]:
        """The step's target and source views with their mattes."""
        seen = [(view.camera, torch.from_numpy(view.matte).float() / 255)]
        if sources is not None:
            seen += list(zip(sources.cameras, sources.mattes, strict=True))
        return seen

    def _sources(self, points: FramePoints, choice: Choice) -> SourceViews | None:
        if self.config.model.appearance == "sh":
            return None
        return with_depth(self.views.sources(choice.sources, choice.frame), points, self.config.model.occlusion)


def heaviest_rows(weight: Tensor, least: float) -> Tensor:
    """Ascending indices of the weights (N,) above ``least``, and of the next lower ones up to whole ROWS.

    Tensors of a step then come in few sizes, and fit into the memory that the steps before it freed.
    """
    count = int((weight > least).sum())
    rounded = min(weight.shape[0], -(-count // ROWS) * ROWS)
    return weight.topk(rounded, sorted=False).indices.sort().values


def keep_in_hull(points: FramePoints, rows: Tensor, before: Tensor, views: list[tuple[Camera, Tensor]]) -> None:
    """Undo the moves that took points out of a view's silhouette, which the object cannot have left.

    ``rows`` (M,) were at ``before`` (M, 3); ``views`` are pinholes with their mattes (H, W) in [0, 1].
    Points that were outside already may move, and a view that does not see a point has no say.
    """
    moved = points.xyz[rows]
    left = torch.zeros(len(rows), dtype=torch.bool)
    for camera, matte in views:
        left |= _inside(moved, camera, matte, beyond=True).logical_not() & _inside(before, camera, matte, beyond=False)
    points.free["xyz"][rows] = torch.where(left[:, None], before, moved)


def _inside(xyz: Tensor, camera: Camera, matte: Tensor, beyond: bool) -> Tensor:
    """Whether the matte covers each point (N, 3) by half; ``beyond`` where its image ends."""
    pixels, depth = project_points(xyz, (camera,))
    size = torch.tensor([matte.shape[1], matte.shape[0]], dtype=pixels.dtype)
    grid = (2 * pixels / size - 1)[:, None]
    covered = functional.grid_sample(matte[None, None], grid, align_corners=False, padding_mode="border")[0, 0, 0]
    within = ((grid[0, 0].abs() < 1).all(dim=-1)) & (depth[0] > 0)
    return torch.where(within, covered >= 0.5, beyond)


def with_depth(sources: SourceViews, points: FramePoints, occlusion: bool) -> SourceViews:
    """The same views with the depth of the frame's points in each, when occlusion is tested."""
    if not occlusion:
        return sources
    depths = [torch.from_numpy(surface_depth(points, camera)) for camera in sources.cameras]
    return SourceViews(sources.images, sources.mattes, torch.stack(depths), sources.cameras)


def surface_depth(points: FramePoints, camera: Camera) -> np.ndarray:
    """(H, W) depth of the points as last evaluated, infinite where nothing covers half a pixel."""
    ones = np.ones((points.xyz.shape[0], 1), dtype=np.float32)
    _, alpha, depth = render_points_numpy(
        points.xyz.numpy(), ones, points.radius.numpy(), points.density.numpy(), camera, layers=4, near=NEAR
    )
    return np.where(alpha > 0.5, depth, np.float32(np.inf)).astype(np.float32)


def _require_finite(terms: dict[str, Tensor], number: int) -> None:
    bad = [name for name, value in terms.items() if not bool(torch.isfinite(value))]
    if bad:
        raise UserError(
            f"step {number}: expected a finite loss, got {float(terms[bad[0]].detach())} in the term '{bad[0]}'; "
            f"the last checkpoint is good: go on from it with --resume and lower learning rates"
        )
