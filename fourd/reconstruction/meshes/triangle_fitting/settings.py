"""Settings of triangle fitting."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class TriangleSettings:
    """Settings for fitting triangles to one frame.

    Attributes:
        triangles: maximum number of soft triangles, at least 16. The fit starts with half of this number.
        cells: number of grid cubes along the longest side of the subject, at least 8. This number determines the
            resolution of connected meshes.
        connect: whether the opaque triangles are joined into a closed mesh. If False, they remain separate.
        max_steps: maximum number of steps; None means no limit.
        max_seconds: maximum fitting time in seconds; None means no limit. At least one of ``max_steps`` and
            ``max_seconds`` must be set.
        interval: number of steps between two rounds of pruning and growth, at least 1.
        soft_share: fraction of the budget, in [0, 1], after which the soft triangles start to become opaque.
        hard_share: fraction of the budget, from ``soft_share`` to 1, after which the triangles are opaque.
        plane: weight of the loss on triangles' distances from the planes of their neighbours.
        normal: weight of the loss on the angles between neighbouring triangles.
        laplacian: weight of the squared Laplacian of connected meshes, with lengths in units of the cube side.
        crease: weight of the normal-consistency loss of connected meshes.
        agreement: a fraction in (0, 1]. A point belongs to the hull only if it is inside the mattes of at least this
            fraction of the views that see it.
        least_views: a fraction in (0, 1]. A point belongs to the hull only if it is seen by at least this fraction of
            all views.
        seed: seed of all random numbers: the order of the views, the initial triangles and the growth.
    """

    triangles: int = 60_000
    cells: int = 96
    connect: bool = True
    max_steps: int | None = None
    max_seconds: float | None = None
    interval: int = 500
    soft_share: float = 0.3
    hard_share: float = 0.45
    plane: float = 0.3
    normal: float = 0.1
    laplacian: float = 0.3
    crease: float = 0.03
    agreement: float = 0.95
    least_views: float = 1 / 2
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError for a value that is out of range."""
        for name, least in (("triangles", 16), ("cells", 8), ("interval", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name}: expected at least {least}, got {getattr(self, name)}")
        if self.max_steps is None and self.max_seconds is None:
            raise ValueError("max_steps: expected a limit of steps or seconds, got neither")
        if self.max_steps is not None and self.max_steps < 1:
            raise ValueError(f"max_steps: expected at least 1, got {self.max_steps}")
        if self.max_seconds is not None and not 0 < self.max_seconds < math.inf:
            raise ValueError(f"max_seconds: expected a number of seconds above 0, got {self.max_seconds:g}")
        if not 0 <= self.soft_share <= self.hard_share <= 1:
            got = f"{self.soft_share:g} and {self.hard_share:g}"
            raise ValueError(f"soft_share, hard_share: expected 0 <= soft_share <= hard_share <= 1, got {got}")
        for name in ("plane", "normal", "laplacian", "crease"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a weight of 0 or more, got {getattr(self, name)}")
        for name in ("agreement", "least_views"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"{name}: expected a share in (0, 1], got {getattr(self, name):g}")
