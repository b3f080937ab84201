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
from fourd.training.background import StaticBackground, surface_depth
from fourd.training.cameras.refinement import Refinement
from fourd.training.config import TrainConfig
from fourd.training.losses.background_opacity import transparency, vantage
from fourd.training.losses.image import ImageLoss
from fourd.training.points.densification import accumulate_gradient_magnitudes, densify, unobserved_points
from fourd.training.points.frame_store import FramePoints
from fourd.training.rendering import Part, composite, evaluate, visible_points
from fourd.training.schedule import StepSample
from fourd.training.views import ViewStore

BACKGROUND_SEED = 2**31
"""No frame has this number."""
SHADOW_STRIDE = 8
"""Of so many points of the background a step asks one whether it lies in shadow without a cause."""


@dataclass(frozen=True)
class StepResult:
    """What a step measured: each term's weighted value, and PSNR in dB of the rendered part."""

    terms: dict[str, float]
    psnr: float


@dataclass(frozen=True)
class _Target:
    """What a step is to show.

    Attributes:
        camera: the camera of the part of the picture that is looked at.
        rgb: (H, W, 3) in [0, 1]; of an object premultiplied by its matte.
        matte: (H, W) what moves; None where the target is a plate.
        filled: (H, W) where rgb is known: an object's matte, all of a picture, the part of a plate that was seen.
    """

    camera: Camera
    rgb: Tensor
    matte: Tensor | None
    filled: Tensor


class Stepper:
    """Holds the model and its optimiser; :meth:`step` trains on one view of one frame, or on one plate."""

    def __init__(
        self,
        model: PointModel,
        config: TrainConfig,
        loss: ImageLoss,
        views: ViewStore,
        background: StaticBackground | None = None,
        refinement: Refinement | None = None,
    ) -> None:
        self.model = model
        self.config = config
        self.loss = loss
        self.views = views
        self.background = background
        self.refinement = refinement
        models = [model] if background is None else [model, background.model]
        named = [pair for each in models for pair in each.named_parameters()]
        planes = [p for name, p in named if "planes" in name]
        others = [p for name, p in named if "planes" not in name]
        self.optimizer = torch.optim.Adam(
            [
                {"params": planes, "lr": config.rates.planes, "base": config.rates.planes},
                {"params": others, "lr": config.rates.mlps, "base": config.rates.mlps},
                *([] if refinement is None else refinement.groups()),
            ],
            betas=(0.9, 0.99),
            eps=1e-15,
            fused=True,
        )
        self.scene_size = float((model.upper - model.lower).max())

    def step(self, points: FramePoints, time: float, choice: StepSample, factor: float, number: int) -> StepResult:
        """Train once; ``factor`` scales all rates, ``number`` names the step in errors.

        Raises UserError naming the step and the loss's term when a value is not finite; nothing
        is changed then.
        """
        target = self._target(choice)
        parts = self._parts(points, time, choice, target.camera, number)
        refinement = self.refinement
        seen = parts if refinement is None else refinement.seen(parts, choice.target)
        render = composite(seen, target.camera, choice.layers)
        colour, coverage = render.features[..., :3], render.features[..., 3]
        if refinement is not None:
            colour = refinement.recoloured(colour, render.alpha, choice.target)
        behind = torch.from_numpy(choice.background)
        predicted = colour + (1 - render.alpha)[..., None] * behind
        truth = target.rgb + (1 - target.filled)[..., None] * behind
        background = self._behind(choice)
        if background is not None:
            # What no plate has seen is not judged.
            predicted = torch.where(target.filled[..., None] > 0, predicted, truth)
        terms = self.loss.terms(predicted, truth, coverage, target.matte)
        if parts[0].displacement is not None:
            displacement = parts[0].displacement / self.model.spacing
            terms["residual"] = self.config.loss.residual * displacement.square().mean()
        if refinement is not None:
            terms["refinement"] = refinement.penalty(choice.target)
        terms |= self._shadow_term(time, choice, number)
        terms |= self._closed_term(choice, number)
        _require_finite(terms, number)
        before = parts[0].free["xyz"].detach()
        self._apply(parts, terms, factor)
        with torch.no_grad():
            if self.config.keep_in_hull and not choice.plate:
                keep_in_hull(points, parts[0].rows, before, _seen_by(target, parts[0].sources))
            for part in parts:
                part.points.radius[part.rows], part.points.density[part.rows] = part.radius, part.density
            shown = colour.clamp(0, 1) if background is None else predicted.clamp(0, 1)
            error = float((shown - (target.rgb if background is None else truth)).square().mean())
        psnr = -10 * math.log10(max(error, 1e-10))
        return StepResult({name: float(value.detach()) for name, value in terms.items()}, psnr)

    def aim(self) -> None:
        """Let views and plates have the cameras as corrected now."""
        if self.refinement is not None:
            self.views.rig = self.refinement.rig()
            if self.background is not None:
                self.background.rig = self.views.rig

    def _behind(self, choice: StepSample) -> StaticBackground | None:
        """The background, where the step's picture has one."""
        return self.background if choice.plate or self.config.background.joint else None

    def _target(self, choice: StepSample) -> _Target:
        background = self._behind(choice)
        if background is None:
            view = self.views.view(choice.target, choice.frame)
            rgb, matte = view.target()
            return _Target(view.camera, rgb, matte, matte)
        if choice.plate:
            plate = background.plates[choice.target]
            side = self.config.background.window_px
            camera = background.camera(choice.target)
            window = placed_window(camera, (side, side), choice.place)
            part = camera.crop(*window)
            rows, columns = slice(window[1], window[1] + window[3]), slice(window[0], window[0] + window[2])
            rgb = torch.tensor(plate.rgb[rows, columns]).float() / 255
            seen = torch.tensor(plate.seen[rows, columns]).float()
            return _Target(part, rgb * seen[..., None], None, seen)
        margin = int(choice.place[0] * (self.config.background.margin_px + 1))
        wide = self.views.around(choice.target, choice.frame, margin)
        rgb = torch.tensor(wide.rgb).float() / 255
        matte = torch.tensor(wide.matte).float() / 255
        return _Target(wide.camera, rgb, matte, torch.ones_like(matte))

    def _parts(self, points: FramePoints, time: float, choice: StepSample, camera: Camera, number: int) -> list[Part]:
        """What moves, unless the target is a plate, and then the background, where there is one."""
        background = self._behind(choice)
        clouds = [] if choice.plate else [points]
        clouds += [] if background is None else [background.points]
        rows = visible_points(clouds, camera, self.config.layers, self.config.hidden_weight)
        parts = []
        if not choice.plate:
            learns = number % self.config.encoder_every == 0
            sources = self._sources(points, choice)
            parts.append(evaluate(self.model, points, rows[0], time, camera, sources, train_encoder=learns))
        if background is not None:
            learns = choice.plate and number % self.config.background.encoder_every == 0
            plates = None
            if self.config.model.appearance != "sh":
                plates = background.sources(choice.sources, fresh=learns)
            shadow_at = None if choice.plate else time
            parts.append(
                evaluate(background.model, background.points, rows[-1], 0.0, camera, plates, shadow_at=shadow_at)
            )
        return parts

    def _shadow_term(self, time: float, choice: StepSample, number: int) -> dict[str, Tensor]:
        """What keeps shadows away from where no picture asks for them, seen by this step or not."""
        background = self._behind(choice)
        if background is None or background.model.shadow is None or choice.plate:
            return {}
        some = background.points.xyz[number % SHADOW_STRIDE :: SHADOW_STRIDE]
        return {"shadow": self.config.loss.shadow * background.model.shadow.departure(some, time)}

    def _closed_term(self, choice: StepSample, number: int) -> dict[str, Tensor]:
        """What closes the background for cameras that stand elsewhere than those of its plates."""
        background, weight = self.background, self.config.loss.closed
        if background is None or weight == 0 or not choice.plate:
            return {}
        cameras = [background.camera(index) for index in background.plates]
        draw = np.random.default_rng([self.config.seed, 4, number])
        viewer = vantage(background.camera(choice.target), cameras, self.config.background.window_px // 2, draw)
        return {"closed": weight * transparency(background, viewer, self.config.hidden_weight)}

    def _apply(self, parts: list[Part], terms: dict[str, Tensor], factor: float) -> None:
        torch.stack(list(terms.values())).sum().backward()
        for group in self.optimizer.param_groups:
            group["lr"] = group["base"] * factor
        self.optimizer.step()
        # At once, not before the next: what lives from step to step among what does not splits the heap.
        self.optimizer.zero_grad(set_to_none=True)
        for part in parts:
            gradients = {
                name: torch.nan_to_num(value.grad) for name, value in part.free.items() if value.grad is not None
            }
            with torch.no_grad():
                part.points.update(part.rows, gradients, self._rates(part, factor))
                accumulate_gradient_magnitudes(part.points, part.rows, gradients["xyz"])
        self.aim()
        if self.background is not None:
            self.background.advance()

    def grow(self, points: FramePoints, choice: StepSample, spent: float) -> None:
        """Give the clouds of a full scene's last step their new points, when it is time for it."""
        config = self.config.densify
        if self.background is None or not config.on or spent > config.until:
            return
        seed = [self.config.seed, 3]
        with torch.no_grad():
            if not choice.plate and int(points.age) % config.frame_every == 0:
                densify(
                    points,
                    config,
                    unobserved_points(points, config.frame_every),
                    [*seed, choice.frame, int(points.age)],
                )
            static = self.background.points
            if self._behind(choice) is not None and int(static.age) % config.background_every == 0:
                hidden = self.background.hidden()
                densify(static, config, hidden, [*seed, BACKGROUND_SEED, int(static.age)])
                self.background.forget()

    def _rates(self, part: Part, factor: float) -> dict[str, float | Tensor]:
        rates = self.config.rates
        moved: float | Tensor = rates.xyz * self.scene_size * factor
        if self.background is not None and part.points is self.background.points:
            moved = self.config.background.xyz_rate * factor * part.points.spacing[part.rows][:, None]
        return {"xyz": moved, "sh": rates.sh * factor, "rgb": rates.sh * factor}

    def _sources(self, points: FramePoints, choice: StepSample) -> SourceViews | None:
        if self.config.model.appearance == "sh":
            return None
        return with_depth(self.views.sources(choice.sources, choice.frame), points, self.config.model.occlusion)


def _seen_by(target: _Target, sources: SourceViews | None) -> list[tuple[Camera, Tensor]]:
    """The step's target and source views with their mattes."""
    assert target.matte is not None
    seen = [(target.camera, target.matte)]
    if sources is not None:
        seen += list(zip(sources.cameras, sources.mattes, strict=True))
    return seen


def placed_window(
    camera: Camera, size: tuple[int, int], place: tuple[float, float, float]
) -> tuple[int, int, int, int]:
    """(left, top, width, height) of a part of ``size`` (width, height), where that fits; ``place`` in [0, 1).

    Its middle may be anywhere, and it is moved into the picture: corners would come too seldom else.
    """
    width, height = min(size[0], camera.width), min(size[1], camera.height)
    left = np.clip(round(place[1] * camera.width - width / 2), 0, camera.width - width)
    top = np.clip(round(place[2] * camera.height - height / 2), 0, camera.height - height)
    return int(left), int(top), width, height


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


def _require_finite(terms: dict[str, Tensor], number: int) -> None:
    bad = [name for name, value in terms.items() if not bool(torch.isfinite(value))]
    if bad:
        raise UserError(
            f"step {number}: expected a finite loss, got {float(terms[bad[0]].detach())} in the term '{bad[0]}'; "
            f"the last checkpoint is good: go on from it with --resume and lower learning rates"
        )
