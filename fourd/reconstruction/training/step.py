"""One training step: render a view, evaluate the loss, and update the networks and the visible points."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.reconstruction.model.kplanes import KPlanes
from fourd.reconstruction.training.cameras.refinement import Refinement
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.distributed.process_group import ALONE, ProcessGroup
from fourd.reconstruction.training.losses.lpips import LPIPS
from fourd.reconstruction.training.losses.term import RenderedStep, weighted_values
from fourd.reconstruction.training.points.dense_adam import DenseAdam
from fourd.reconstruction.training.points.densification import accumulate_gradient_magnitudes
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.near_plane import revert_moves_before_near
from fourd.reconstruction.training.points.selective_adam import BETAS, EPSILON
from fourd.reconstruction.training.points.silhouette import revert_moves_out_of_silhouettes
from fourd.reconstruction.training.points.smoothing import smooth_surface
from fourd.reconstruction.training.rendering import composite_samples
from fourd.reconstruction.training.scenes.scene import OptimizedPoints, Target, TrainingScene
from fourd.reconstruction.training.schedule import StepSample


@dataclass(frozen=True)
class StepResult:
    """Measurements of a step.

    Attributes:
        terms: name -> weighted value of each loss term.
        psnr: PSNR of the rendered part of the image, in dB.
    """

    terms: dict[str, float]
    psnr: float


class Stepper:
    """Trains a scene. Each step renders one view of a frame, or one clean plate."""

    def __init__(
        self,
        scene: TrainingScene,
        config: TrainConfig,
        lpips: LPIPS | None = None,
        refinement: Refinement | None = None,
        group: ProcessGroup = ALONE,
    ) -> None:
        self.scene = scene
        self.config = config
        self.refinement = refinement
        self.group = group
        self.terms = scene.loss_terms(lpips, refinement)
        planes, others = parameters_by_kind(scene.models.values())
        self.optimizer = DenseAdam(
            [
                {"params": planes, "lr": config.rates.planes, "base": config.rates.planes},
                {"params": others, "lr": config.rates.mlps, "base": config.rates.mlps},
                *([] if refinement is None else refinement.parameter_groups()),
            ],
            betas=BETAS,
            eps=EPSILON,
            fused=True,
        )

    def step(self, points: FramePoints, time: float, sample: StepSample, rate_factor: float, number: int) -> StepResult:
        """Perform one training step.

        Args:
            points: points of the sample's frame, which are changed in place.
            time: time of the frame, in [0, 1].
            sample: the frame and views to render.
            rate_factor: factor from the schedule that multiplies all learning rates.
            number: number of the update, for schedules and error messages. One update consists of one step per rank.

        Raises:
            UserError: a loss term is not finite. Models and points are unchanged in this case.
        """
        target = self.scene.target(sample)
        evaluated = self.scene.evaluate_step(points, time, sample, target.camera, number)
        colour, rendered = self._render(evaluated, target, time, sample, number)
        terms = weighted_values(self.terms, rendered)
        # All terms are read at once, because each reading waits for a GPU.
        stacked = torch.stack(list(terms.values()))
        values = dict(zip(terms, stacked.detach().tolist(), strict=True))
        _require_finite(values, number)
        before = [each.parameters["xyz"].detach() for each in evaluated]
        self._update(evaluated, stacked.sum(), rate_factor)
        with torch.no_grad():
            if self.config.smoothing > 0 and target.matte is not None:
                rates = self.scene.xyz_rate(evaluated[0], rate_factor)
                smooth_surface(points, evaluated[0].rows, rates, self.config.smoothing)
            if self.config.keep_in_hull and target.matte is not None:
                views = _silhouettes(target.camera, target.matte, evaluated[0])
                revert_moves_out_of_silhouettes(points, evaluated[0].rows, before[0], views)
            for each, start in zip(evaluated, before, strict=True):
                revert_moves_before_near(each.cloud, each.rows, start, target.camera, self.scene.least_depth(each))
                each.cloud.radius[each.rows] = each.evaluated.radius
                each.cloud.density[each.rows] = each.evaluated.density
            shown, truth = (rendered.prediction, rendered.truth) if target.fills_picture else (colour, target.rgb)
            error = float((shown.clamp(0, 1) - truth).square().mean())
        psnr = -10 * math.log10(max(error, 1e-10))
        return StepResult(values, psnr)

    @property
    def dense_parameters(self) -> list[Tensor]:
        """The parameters that all ranks share: the networks, the planes, and the corrections of cameras."""
        return [parameter for group in self.optimizer.param_groups for parameter in group["params"]]

    def update_cameras(self) -> None:
        """Apply the current camera corrections to the cameras of views and plates."""
        if self.refinement is not None:
            self.scene.set_rig(self.refinement.rig())

    def _render(
        self, evaluated: Sequence[OptimizedPoints], target: Target, time: float, sample: StepSample, number: int
    ) -> tuple[Tensor, RenderedStep]:
        """Render the points. Returns the rendered colours (H, W, 3) without the background colour, and the data for the
        loss terms."""
        clouds = [each.renderable for each in evaluated]
        if self.refinement is not None:
            clouds = self.refinement.attach_camera_gradient(clouds, sample.target)
        features, alpha = composite_samples(clouds, target.camera, sample.layers, self.scene.near, self.config.samples)
        colour, coverage = features[..., :3], features[..., 3]
        if self.refinement is not None:
            colour = self.refinement.recolour(colour, alpha, sample.target)
        background_colour = torch.from_numpy(sample.background_colour).to(colour)
        prediction = colour + (1 - alpha)[..., None] * background_colour
        truth = target.rgb + (1 - target.known)[..., None] * background_colour
        if target.fills_picture:
            prediction = torch.where(target.known[..., None] > 0, prediction, truth)
        first = evaluated[0].evaluated
        sh = None if target.matte is None else first.sh
        return colour, RenderedStep(
            number, time, sample, prediction, truth, coverage, target.matte, sh, first.displacement
        )

    def _update(self, evaluated: Sequence[OptimizedPoints], loss: Tensor, rate_factor: float) -> None:
        _set_gradients(
            loss, [*self.dense_parameters, *(leaf for each in evaluated for leaf in each.parameters.values())]
        )
        self.group.average_gradients(self.dense_parameters)
        for group in self.optimizer.param_groups:
            group["lr"] = group["base"] * rate_factor * self.group.rate_factor
        self.optimizer.step()
        # Gradients are deleted here, because keeping them until the next step would fragment the heap.
        self.optimizer.zero_grad(set_to_none=True)
        for each in evaluated:
            found = {name: leaf.grad.contiguous() for name, leaf in each.parameters.items() if leaf.grad is not None}
            colour_rate = self.config.rates.sh * rate_factor
            rates: dict[str, float | Tensor] = {"sh": colour_rate, "rgb": colour_rate}
            rates["xyz"] = self.scene.xyz_rate(each, rate_factor)
            with torch.no_grad():
                each.cloud.optimizer.step(each.cloud.parameters, each.rows, found, rates)
                accumulate_gradient_magnitudes(each.cloud, each.rows, found["xyz"])
        self.update_cameras()
        self.scene.finish_step()


def parameters_by_kind(models: Collection[nn.Module]) -> tuple[list[nn.Parameter], list[nn.Parameter]]:
    """Return the parameters of all K-Planes in ``models``, and the other parameters, in the order of the models."""
    parameters = [parameter for model in models for parameter in model.parameters()]
    grids = [module for model in models for module in model.modules() if isinstance(module, KPlanes)]
    planes = {id(parameter) for grid in grids for parameter in grid.parameters()}
    return [each for each in parameters if id(each) in planes], [each for each in parameters if id(each) not in planes]


def _set_gradients(loss: Tensor, leaves: Sequence[Tensor]) -> None:
    """Set the attribute ``grad`` of the leaves, as ``loss.backward()`` does for leaves without a gradient. In contrast
    to ``backward()``, no operators are called for each leaf."""
    free = [leaf for leaf in leaves if leaf.requires_grad]
    for leaf, gradient in zip(free, torch.autograd.grad(loss, free, allow_unused=True), strict=True):
        leaf.grad = gradient


def _silhouettes(camera: Camera, matte: Tensor, points: OptimizedPoints) -> list[tuple[tuple[Camera, ...], Tensor]]:
    """Return the cameras and mattes of the step's target view and of its source views."""
    target = ((camera,), matte[None])
    return [target] if points.sources is None else [target, (points.sources.cameras, points.sources.mattes)]


def _require_finite(terms: dict[str, float], number: int) -> None:
    bad = [name for name, value in terms.items() if not math.isfinite(value)]
    if bad:
        raise UserError(
            f"step {number}: expected a finite loss, got {terms[bad[0]]} in the term '{bad[0]}'; "
            f"the last checkpoint is intact: resume with --resume and lower learning rates"
        )
