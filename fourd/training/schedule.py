"""Which frame and views a step takes, and how far the budget is spent."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fourd.cameras import Camera, nearest_views
from fourd.training.config import RateConfig, TrainConfig


@dataclass(frozen=True)
class StepSample:
    """What one step renders: indices of a frame, the target camera and its source cameras; K; the colour behind.

    Attributes:
        plate: whether the target is the camera's plate, and not its picture of the frame.
        place: three numbers in [0, 1) that say which part of the target is looked at in a full scene.
    """

    frame: int
    target: int
    sources: list[int]
    background: np.ndarray
    layers: int
    plate: bool = False
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)


class StepSampler:
    """Draws each step's frame, target and sources from the seed and the step's number alone.

    No state is kept between steps, so that a resumed run draws what an unbroken one would.
    """

    def __init__(
        self, config: TrainConfig, cameras: tuple[Camera, ...], training: list[int], frames: int, focus: np.ndarray
    ) -> None:
        self._config = config
        self._training = training
        self._frames = frames
        self._least_layers = config.least_layers if config.scene == "object" else config.background.least_layers
        self._pools = {
            target: source_pool(cameras, target, training, config.neighbour_pool, focus) for target in training
        }

    def choose(self, step: int) -> StepSample:
        """The choice of a step: over F * V steps every frame meets every view once."""
        views = len(self._training)
        epoch, place = divmod(step, self._frames * views)
        order = np.random.default_rng([self._config.seed, 1, epoch]).permutation(self._frames * views)
        frame, view = divmod(int(order[place]), views)
        target = self._training[view]
        draw = np.random.default_rng([self._config.seed, 2, step])
        pool = self._pools[target]
        count = min(self._config.model.neighbours, len(pool))
        sources = sorted(draw.choice(len(pool), size=count, replace=False).tolist())
        background = draw.random(3) if self._config.random_background else np.zeros(3)
        layers = int(draw.integers(min(self._least_layers, self._config.layers), self._config.layers + 1))
        chosen = [pool[i] for i in sources]
        choice = StepSample(frame, target, chosen, background.astype(np.float32), layers)
        if self._config.scene == "object":
            return choice
        plate = bool(draw.random() < self._config.background.share)
        return replace(choice, plate=plate, place=(draw.random(), draw.random(), draw.random()))


def source_pool(
    cameras: tuple[Camera, ...], target: int, training: list[int], count: int, focus: np.ndarray
) -> list[int]:
    """The ``count`` training cameras nearest to a target camera, which is never its own source."""
    others = [camera for camera in training if camera != target]
    nearest = nearest_views(cameras[target], [cameras[camera] for camera in others], count, focus)
    return [others[i] for i in nearest]


def budget_spent(config: TrainConfig, step: int, seconds: float) -> float:
    """Share in [0, 1] of the step or time budget that is used, whichever is further on."""
    shares = [0.0]
    if config.max_steps is not None:
        shares.append(step / config.max_steps)
    if config.max_seconds is not None:
        shares.append(seconds / config.max_seconds)
    return min(1.0, max(shares))


def rate_factor(rates: RateConfig, step: int, spent: float) -> float:
    """Factor on all learning rates: a linear warm-up, then exponential decay to ``final``."""
    warm = min(1.0, (step + 1) / max(1, rates.warm_up))
    return float(warm * rates.final**spent)
