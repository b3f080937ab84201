"""Colours of points in source views that do not see the points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import BakedFrame


def mean_colours(frame: BakedFrame) -> NDArray[np.uint8]:
    """Return the mean colours (N, 3) over the source views, weighted by the blend weights.

    For a point whose blend weights are all 0, the colour is the mean over all source views with equal weights.
    """
    weights = frame.blend_weights.astype(np.float32)
    weights[~weights.any(axis=1)] = 1
    mean = np.einsum("nv,nvc->nc", weights, frame.rgb.astype(np.float32)) / weights.sum(axis=1, keepdims=True)
    return np.rint(mean).astype(np.uint8)


def fill_unseen_colours(frame: BakedFrame) -> BakedFrame:
    """Return the frame with new colours: each point has its mean colour in all views in which its blend weight is 0.

    A view with a blend weight of 0 does not see the point. The stored colour in this view belongs to another surface.
    Shading uses this stored colour only if the blend weights of the point in all selected views are 0.
    """
    if frame.view_count == 0:
        return frame
    unseen = frame.blend_weights == 0
    return replace(frame, rgb=np.where(unseen[..., None], mean_colours(frame)[:, None], frame.rgb))


def has_own_unseen_colours(frame: BakedFrame) -> bool:
    """Return whether the colour of any point, in any view in which the point's blend weight is 0, differs from the
    point's mean colour."""
    return frame.view_count > 0 and not np.array_equal(fill_unseen_colours(frame).rgb, frame.rgb)
