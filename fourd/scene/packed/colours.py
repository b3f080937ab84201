"""Colours of points in source views that do not see the points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fourd.scene.scene import BakedFrame


def mean_colours(frame: BakedFrame) -> NDArray[np.uint8]:
    """Return the mean colours (N, 3) of the points over the source views, weighted by the blend weights.

    If all blend weights of a point are 0, all source views have equal weights.
    """
    weights = frame.blend_weights.astype(np.float32)
    weights[~weights.any(axis=1)] = 1
    mean = np.einsum("nv,nvc->nc", weights, frame.rgb.astype(np.float32)) / weights.sum(axis=1, keepdims=True)
    return np.rint(mean).astype(np.uint8)


def fill_unseen_colours(frame: BakedFrame) -> BakedFrame:
    """Return the frame with new colours in the views in which a point's blend weight is 0: there, the point gets its
    mean colour.

    Such a view does not see the point, so the replaced colour belongs to another surface. Shading uses the colour in
    such a view only if the point's blend weights in all selected views are 0.
    """
    if frame.view_count == 0:
        return frame
    unseen = frame.blend_weights == 0
    return replace(frame, rgb=np.where(unseen[..., None], mean_colours(frame)[:, None], frame.rgb))


def has_own_unseen_colours(frame: BakedFrame) -> bool:
    """Return True if any point has a colour other than its mean colour in a view in which the point's blend weight is
    0."""
    return frame.view_count > 0 and not np.array_equal(fill_unseen_colours(frame).rgb, frame.rgb)
