"""The budget of a fit, and the schedule by which soft triangles become opaque.

The alpha of a triangle at a pixel is its opacity times a window function, which falls from 1 at the triangle's incentre
to 0 at its edges (:func:`fourd.rendering.triangles.splat_triangles`). In the soft phase, the exponent sigma of the
window function is 1.16, and opacities have no lower limit. In the next phase, sigma decreases geometrically to 1e-4
while a lower limit of the opacity rises from 0.1 to 0.9999, so that the triangles become opaque up to their edges. The
initial value of sigma comes from Held et al. 2025. The final value of sigma and the range of the lower limit come from
the variant of their method that makes triangles opaque. In fourd, sigma and the lower limit depend on the spent
fraction of the budget.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import monotonic

from fourd.reconstruction.meshes.triangle_fitting.settings import TriangleSettings

SIGMA_RANGE = (1.16, 1e-4)
FLOOR_RANGE = (0.1, 0.9999)
SLOWEST_RATE = 0.1
"""Learning rate at the end, as a fraction of the learning rate at the start."""


@dataclass(frozen=True)
class Phase:
    """The state of the schedule at one point of the fit.

    Attributes:
        sigma: exponent of the window function.
        floor: lower limit of the opacity.
        rate: factor for the learning rate of positions.
        grows: whether pruning and growth of triangles are enabled.
    """

    sigma: float
    floor: float
    rate: float
    grows: bool


def phase_at(share: float, settings: TriangleSettings) -> Phase:
    """Return the phase when the fraction ``share``, in [0, 1], of the budget is spent. The result is used only
    while ``share`` is below ``settings.hard_share``. From ``settings.hard_share`` on, the triangles are opaque, and the
    only scheduled quantity is the factor for their learning rates (:func:`surface_rate`)."""
    rate = SLOWEST_RATE**share
    if share < settings.soft_share:
        return Phase(SIGMA_RANGE[0], 0.0, rate, True)
    length = settings.hard_share - settings.soft_share
    hardness = min((share - settings.soft_share) / length, 1.0) if length > 0 else 1.0
    sigma = SIGMA_RANGE[0] * (SIGMA_RANGE[1] / SIGMA_RANGE[0]) ** hardness
    floor = FLOOR_RANGE[0] + (FLOOR_RANGE[1] - FLOOR_RANGE[0]) * hardness
    return Phase(sigma, floor, rate, False)


def surface_rate(share: float, settings: TriangleSettings) -> float:
    """Return the factor for the learning rates of opaque triangles, which is 1 at ``hard_share`` and SLOWEST_RATE at
    the end."""
    length = 1 - settings.hard_share
    return float(SLOWEST_RATE ** min(max((share - settings.hard_share) / length, 0.0), 1.0)) if length > 0 else 1.0


class Budget:
    """Measures the spent fraction of a budget of steps, seconds or both. The clock starts when the object is created.

    Attributes:
        steps: number of completed optimization steps.
    """

    def __init__(self, max_steps: int | None, max_seconds: float | None) -> None:
        """Start the clock. None means no limit. If both limits are given, the one that is reached first ends the
        fit."""
        self.steps = 0
        self._max_steps, self._max_seconds = max_steps, max_seconds
        self._start = monotonic()
        self._is_closed = False

    @property
    def share(self) -> float:
        """The spent fraction in [0, 1]."""
        if self._is_closed:
            return 1.0
        steps = 0.0 if self._max_steps is None else self.steps / self._max_steps
        seconds = 0.0 if self._max_seconds is None else (monotonic() - self._start) / self._max_seconds
        return min(max(steps, seconds), 1.0)

    def close(self) -> None:
        """Mark the whole budget as spent."""
        self._is_closed = True

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Stop the clock during work that is not part of the fit."""
        before = monotonic()
        try:
            yield
        finally:
            self._start += monotonic() - before
