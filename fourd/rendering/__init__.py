"""The differentiable point renderer: :func:`render_points` and :func:`point_visibility`.

Importing this package does not import torch; the first use of one of the two functions does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.rendering.points import PointRender, point_visibility, render_points

__all__ = ["PointRender", "point_visibility", "render_points"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "PointRender": "points",
        "point_visibility": "points",
        "render_points": "points",
    },
)
