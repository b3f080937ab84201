"""The differentiable point renderer: :func:`render_points` and :func:`point_visibility`.

Importing this package does not import torch; the first use of one of the two functions does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fourd.rendering.points import PointRender, point_visibility, render_points

__all__ = ["PointRender", "point_visibility", "render_points"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fourd.rendering import points

    return getattr(points, name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
