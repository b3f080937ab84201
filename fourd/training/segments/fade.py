"""Cross-fade between the points of two models in a frame that two segments share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GOLDEN_RATIO = (5**0.5 - 1) / 2


def kept_points(count: int, share: float, *, is_first: bool) -> NDArray[np.int64]:
    """Indices of the points that a segment contributes to a frame, in ascending order.

    If two segments share the frame, each of them has points on the whole surface. Each segment contributes only the
    share ``share`` of its points, spread evenly over the surface. The number of points of the frame and the number of
    points along each viewing ray therefore hardly change during the fade. In Morton order, points with close indices
    are usually close in space. Whether a point is chosen depends on the value ``index * GOLDEN_RATIO % 1``. The values
    of successive indices are evenly distributed in [0, 1). The chosen points are therefore spread evenly over the
    surface.

    Args:
        count: number of points of the segment in this frame, in Morton order.
        share: share of the segment in this frame, in [0, 1].
        is_first: whether the segment is the earlier of the two segments. The two segments choose complementary indices.
    """
    phase = np.arange(count) * GOLDEN_RATIO % 1.0
    return np.flatnonzero(phase >= 1.0 - share if is_first else phase < share)
