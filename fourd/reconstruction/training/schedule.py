"""Choose each step's frame and views at random, and schedule the learning rates over the budget."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, fading_weights, nearest_views
from fourd.reconstruction.training.config import RateConfig, TrainConfig
from fourd.reconstruction.training.distributed.process_group import ALONE, ProcessGroup


@dataclass(frozen=True)
class StepSample:
    """Frame, views and options of one training step.

    Attributes:
        frame: index of the frame in the selected frames.
        target: index of the target camera.
        sources: indices of the source cameras.
        source_weights: (V,) float32 view weights, which multiply the blend weights of the source cameras.
        background_colour: (3,) float32 RGB on which prediction and ground truth are composited.
        layers: maximum number K of points that are composited at each pixel.
        is_plate: whether the target is the camera's clean plate instead of the camera's image of the frame.
        position: three numbers in [0, 1) that select the rendered part of the target in a full scene. For a frame, the
            first number determines the margin around the matte. For a plate, the last two numbers (x, y) determine the
            centre of the window.
    """

    frame: int
    target: int
    sources: list[int]
    source_weights: np.ndarray
    background_colour: np.ndarray
    layers: int
    is_plate: bool = False
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


class StepSampler:
    """Determines the sample of each step from only the seed and the step's number. Because the sampler stores no state
    between steps, a resumed run has the same samples as an uninterrupted run. The only exception is the choice of the
    cameras, see :meth:`use`.
    """

    def __init__(
        self,
        config: TrainConfig,
        cameras: tuple[Camera, ...],
        training: list[int],
        frames: int,
        focus: np.ndarray,
        group: ProcessGroup = ALONE,
    ) -> None:
        self._config = config
        self._frames = group.own_frames(frames)
        self._group = group
        self._min_layers = config.least_layers if config.scene == "object" else config.background.least_layers
        self._cameras = cameras
        self._focus = focus
        self.use(training)

    def use(self, training: list[int]) -> None:
        """Sample only the cameras ``training``, as targets and as sources."""
        self._training = training
        self._known: dict[int, StepSample] = {}
        self._weights: dict[tuple[int, ...], NDArray[np.float32]] = {}
        self._pools = {
            target: source_pool(self._cameras, target, training, self._config.neighbour_pool, self._focus)
            for target in training
        }

    def sample(self, step: int) -> StepSample:
        """Determine the sample of the training step that this rank performs. W ranks perform W successive steps in
        parallel, and ``step`` is the number of the first of them.

        Let F be the number of frames that this rank owns, and V the number of training views. An epoch of this rank
        consists of F * V of its own steps, in which it samples every training view of each of its frames exactly once.
        Steps of other ranks do not count.
        """
        if step not in self._known:
            # Two samples are kept, because a step also asks for that of the next step, in order to prepare it.
            self._known = {**dict([*self._known.items()][-1:]), step: self._draw(step)}
        return self._known[step]

    def _draw(self, step: int) -> StepSample:
        views, group = len(self._training), self._group
        count = len(self._frames) * views
        epoch, place = divmod(step // group.size, count)
        stream = () if group.size == 1 else (group.rank, group.size)
        order = np.random.default_rng([self._config.seed, 1, epoch, *stream]).permutation(count)
        row, view = divmod(int(order[place]), views)
        frame, target = self._frames[row], self._training[view]
        rng = np.random.default_rng([self._config.seed, 2, step + group.rank])
        pool = self._pools[target]
        count = min(self._config.model.neighbours, len(pool))
        drawn = sorted(rng.choice(len(pool), size=count, replace=False).tolist())
        colour = rng.random(3) if self._config.random_background else np.zeros(3)
        layers = int(rng.integers(min(self._min_layers, self._config.layers), self._config.layers + 1))
        sources = [pool[i] for i in drawn]
        # A target has few different sets of sources, and their weights take longer than the rest of the sample.
        key = (target, *sources)
        if key not in self._weights:
            self._weights[key] = self._source_weights(target, sources)
        weights = self._weights[key]
        sample = StepSample(frame, target, sources, weights, colour.astype(np.float32), layers)
        if self._config.scene == "object":
            return sample
        is_plate = bool(rng.random() < self._config.background.share)
        return replace(sample, is_plate=is_plate, position=(rng.random(), rng.random(), rng.random()))

    def _source_weights(self, target: int, sources: list[int]) -> NDArray[np.float32]:
        """Compute the view weights of the cameras ``sources`` for the camera ``target``, which is not one of the
        sources."""
        if not self._config.model.fade_views:
            return np.ones(len(sources), np.float32)
        others = [camera for camera in self._training if camera != target]
        chosen = [others.index(camera) for camera in sources]
        return fading_weights(self._cameras[target], [self._cameras[i] for i in others], chosen, self._focus)


def source_pool(
    cameras: tuple[Camera, ...], target: int, training: list[int], count: int, focus: np.ndarray
) -> list[int]:
    """Return the indices of the ``count`` training cameras nearest to the target camera, which is itself excluded."""
    others = [camera for camera in training if camera != target]
    nearest = nearest_views(cameras[target], [cameras[camera] for camera in others], count, focus)
    return [others[i] for i in nearest]


def budget_spent(config: TrainConfig, step: int, seconds: float) -> float:
    """Compute the fraction of the training budget that is spent, in [0, 1]. If both steps and time are limited, it is
    the larger of the two fractions."""
    shares = [0.0]
    if config.max_steps is not None:
        shares.append(step / config.max_steps)
    if config.max_seconds is not None:
        shares.append(seconds / config.max_seconds)
    return min(1.0, max(shares))


def rate_factor(rates: RateConfig, step: int, spent: float) -> float:
    """Compute the factor of all learning rates: a linear warm-up times an exponential decay to ``rates.final``."""
    warm = min(1.0, (step + 1) / max(1, rates.warm_up))
    return float(warm * rates.final**spent)
