"""The state of a measurement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Measurement:
    """Measures the distance between two places of a scene, on which the user clicks.

    Attributes:
        is_on: whether clicks choose places.
        places: the chosen positions (3,) in world units; at most two.
    """

    def __init__(self) -> None:
        self.is_on = False
        self.places: tuple[NDArray[np.float64], ...] = ()

    @property
    def length(self) -> float | None:
        """The distance in world units, or None until two places are chosen."""
        return float(np.linalg.norm(self.places[1] - self.places[0])) if len(self.places) == 2 else None

    def toggle(self) -> None:
        """Switch measuring on or off. The places are forgotten."""
        self.is_on, self.places = not self.is_on, ()

    def choose(self, place: NDArray[np.float64]) -> None:
        """Choose a place. A third one starts the next measurement."""
        self.places = (*self.places, place) if len(self.places) < 2 else (place,)

    def reset(self) -> None:
        """Switch measuring off, because another scene is shown."""
        self.is_on, self.places = False, ()
