"""What a radiance field of the background is made of, and how it is fitted."""

from __future__ import annotations

from dataclasses import dataclass

from fourd.ops.hashgrid.shape import HashGridShape


@dataclass(frozen=True)
class RadianceConfig:
    """The field that background points are found with (Instant-NGP, Mueller et al. 2022); unused by other ways."""

    levels: int = 16
    """Resolutions of the hash grid, from 1 to 32."""
    features: int = 2
    """Numbers of an entry, from 1 to 8."""
    log2_entries: int = 19
    """Logarithm of the most entries of a level, from 4 to 24."""
    coarsest: int = 16
    """Cells a side of the coarsest level, across all of contracted space."""
    finest: int = 2048
    """Cells a side of the finest level."""
    hidden: int = 32
    """Width of the networks of density and of colour."""
    occupancy: int = 128
    """Cells a side of the occupancy grid."""
    steps: int = 750
    """Steps of Adam."""
    rays: int = 1536
    """Rays of a step."""
    samples: int = 32
    """Places on a ray at which the field is asked."""
    rate: float = 1e-2
    """Learning rate at the start; a tenth of it is left at the end."""
    measured: float = 1.0
    """Weight of the distance between a ray's light and the depth that stereo measured there."""
    continued: float = 0.2
    """The same for depths that are only continued from what was measured around."""
    distortion: float = 3e-3
    """Weight of what draws a ray's light to one place."""

    def __post_init__(self) -> None:
        """Raise ValueError, naming the field, what was expected and what came."""
        _ = self.grid
        for name in ("hidden", "occupancy", "steps", "rays", "samples"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, got {getattr(self, name)}")
        for name in ("rate", "measured", "continued", "distortion"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: expected 0 or more, got {getattr(self, name)}")

    @property
    def grid(self) -> HashGridShape:
        """The hash grid's sizes."""
        return HashGridShape(self.levels, self.features, self.log2_entries, self.coarsest, self.finest)
