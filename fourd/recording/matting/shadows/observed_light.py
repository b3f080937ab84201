"""The light on the background in one image, relative to the light in the empty scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class ObservedLight:
    """The light at each pixel of an image, if the pixel shows the background.

    Attributes:
        light: (h, w) factor by which the pixel's colour is the background's colour; below 1 in shadow.
        is_shaded: (h, w) bool, true where the pixel's colour is ``light`` times the background's colour within the
            noise. It is false where the background's colour is not known.
        is_known: (h, w) bool, true where the background's colour is known.
    """

    light: Floats
    is_shaded: NDArray[np.bool_]
    is_known: NDArray[np.bool_]
