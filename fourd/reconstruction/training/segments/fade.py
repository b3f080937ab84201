"""Cross-fade between the points of two models in a frame that belongs to two segments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GOLDEN_RATIO = (5**0.5 - 1) / 2


def kept_points(count: int, share: float, *, is_first: bool) -> NDArray[np.int64]:
    """Return the indices of the points that a segment contributes to a frame, in ascending order.

    If a frame belongs to two segments, each of them has points on the whole surface. To keep the number of points in
    the frame and along each viewing ray almost constant during the fade, each segment contributes only the fraction
    ``share`` of its points, spread evenly over the surface.

    The value ``index * GOLDEN_RATIO % 1`` decides whether a point is chosen. For successive indices, these values are
    evenly distributed in [0, 1). The chosen points are spread evenly over the surface because, in Morton order, points
    with close indices are usually close in space.

    Args:
        count: number of points of the segment in this frame, in Morton order.
        share: fraction of the segment's points that are chosen in this frame, in [0, 1].
        is_first: whether the segment is the earlier of the two segments. If their fractions sum to 1, the two segments
            choose complementary indices.
    """
    phase = np.arange(count) * GOLDEN_RATIO % 1.0
    return np.flatnonzero(phase >= 1.0 - share if is_first else phase < share)
