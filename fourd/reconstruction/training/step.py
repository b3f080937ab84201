"""One training step: render a view, evaluate the loss, and update the networks and the visible points."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
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
from fourd.reconstruction.training.losses.term import RenderedStep, term_values
from fourd.reconstruction.training.points.dense_adam import DenseAdam
from fourd.reconstruction.training.points.densification import accumulate_gradient_magnitudes
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.near_plane import revert_moves_before_near
from fourd.reconstruction.training.points.selective_adam import BETAS, EPSILON
from fourd.reconstruction.training.points.silhouette import revert_moves_out_of_silhouettes
from fourd.reconstruction.training.points.smoothing import smooth_surface
from fourd.reconstruction.training.rendering import composite_samples
from fourd.reconstruction.training.scenes.scene import OptimizedPoints, PreparedStep, Target, TrainingScene
from fourd.reconstruction.training.schedule import StepSample
from fourd.rendering.ops.loading import as_array
from fourd.rendering.ops.step_images.op import add_background, clamped_error, resolve_samples
from fourd.rendering.ops.step_images.reference import average_samples, on_background


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
        self._weights = {term.name: term.weight for term in self.terms}
        # The gradient of each term in the sum of the weighted terms.
        self._upstream = {
            name: torch.tensor(weight, dtype=torch.float32, device=scene.views.device)
            for name, weight in self._weights.items()
        }
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

    def step(
        self,
        points: FramePoints,
        time: float,
        sample: StepSample,
        rate_factor: float,
        prepared: PreparedStep,
        number: int,
    ) -> StepResult:
        """Perform one training step.

        Args:
            points: points of the sample's frame, which are changed in place.
            time: time of the frame, in [0, 1].
            sample: the frame and views to render.
            rate_factor: factor from the schedule that multiplies all learning rates.
            prepared: what the scene has prepared for this step.
            number: number of the update, for schedules and error messages. One update consists of one step per rank.

        Raises:
            UserError: a loss term is not finite. Models and points are unchanged in this case.
        """
        target = prepared.target
        evaluated = self.scene.evaluate_step(points, time, sample, prepared, number)
        colour, rendered = self._render(evaluated, target, time, sample, number)
        terms = term_values(self.terms, rendered)
        found = _read(list(terms.values()))
        values = {name: self._weights[name] * value for name, value in zip(terms, found, strict=True)}
        _require_finite(values, number)
        before = [each.parameters["xyz"].detach() for each in evaluated]
        self._update(evaluated, terms, rate_factor)
        with torch.no_grad():
            if self.config.smoothing > 0 and target.matte is not None:
                rates = self.scene.xyz_rate(evaluated[0], rate_factor)
                smooth_surface(points, evaluated[0].rows, rates, self.config.smoothing)
            if self.config.keep_in_hull and target.matte is not None:
                views = _silhouettes(target.camera, target.matte, evaluated[0])
                revert_moves_out_of_silhouettes(points, evaluated[0].rows, before[0], views)
            for each, start in zip(evaluated, before, strict=True):
                revert_moves_before_near(each.cloud, each.rows, start, target.camera, self.scene.least_depth(each))
                each.cloud.radius.index_copy_(0, each.rows, each.evaluated.radius)
                each.cloud.density.index_copy_(0, each.rows, each.evaluated.density)
            shown, truth = (rendered.prediction, rendered.truth) if target.fills_picture else (colour, target.rgb)
            error = clamped_error(shown, truth)
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
        samples, behind = self.config.samples, sample.background_colour.tolist()
        features, alpha = composite_samples(clouds, target.camera, sample.layers, self.scene.near, samples)
        if self.refinement is None:
            colour, coverage, prediction = resolve_samples(features, alpha, behind, samples)
        else:
            means, alpha = average_samples(features, alpha, samples)
            colour, coverage = self.refinement.recolour(means[..., :3], alpha, sample.target), means[..., 3]
            prediction = on_background(colour, alpha, behind)
        truth = add_background(target.rgb, target.known, behind)
        if target.fills_picture:
            prediction = torch.where(target.known[..., None] > 0, prediction, truth)
        first = evaluated[0].evaluated
        sh = None if target.matte is None else first.sh
        return colour, RenderedStep(
            number, time, sample, prediction, truth, coverage, target.matte, sh, first.displacement
        )

    def _update(self, evaluated: Sequence[OptimizedPoints], terms: Mapping[str, Tensor], rate_factor: float) -> None:
        leaves = [*self.dense_parameters, *(leaf for each in evaluated for leaf in each.parameters.values())]
        set_gradients(list(terms.values()), [self._upstream[name] for name in terms], leaves)
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


def set_gradients(terms: Sequence[Tensor], weights: Sequence[Tensor], leaves: Sequence[Tensor]) -> None:
    """Set the attribute ``grad`` of the leaves to the gradient of the weighted sum of the terms, as ``backward()`` does
    for leaves without a gradient. In contrast to ``backward()``, no operators are called for each leaf, nor for the
    sum."""
    free = [leaf for leaf in leaves if leaf.requires_grad]
    used = [(term, weight) for term, weight in zip(terms, weights, strict=True) if term.requires_grad]
    outputs, upstream = [term for term, _ in used], [weight for _, weight in used]
    gradients = torch.autograd.grad(outputs, free, upstream, allow_unused=True)
    for leaf, gradient in zip(free, gradients, strict=True):
        leaf.grad = gradient


def _read(scalars: Sequence[Tensor]) -> list[float]:
    """Return the values of tensors with one number each."""
    if all(scalar.device.type == "cpu" for scalar in scalars):
        return [float(as_array(scalar)) for scalar in scalars]
    # All are read at once, because each reading waits for a GPU.
    return [float(value) for value in torch.stack(list(scalars)).detach().tolist()]


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
