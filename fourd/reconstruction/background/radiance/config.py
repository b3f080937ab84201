"""Architecture and optimisation settings of the background's radiance field."""

from __future__ import annotations

from dataclasses import dataclass

from fourd.rendering.ops.hashgrid.shape import HashGridShape


@dataclass(frozen=True)
class RadianceConfig:
    """Radiance field (Instant-NGP, Mueller et al. 2022) that gives depths of background points (`seeding: ngp`)."""

    levels: int = 16
    """Number of resolution levels of the hash grid, 1 to 32."""
    features: int = 2
    """Number of features per hash table entry, 1 to 8."""
    log2_entries: int = 19
    """Base-2 logarithm of the maximum number of hash table entries per level, 4 to 24."""
    coarsest: int = 16
    """Number of grid cells per side at the coarsest level. The grid covers the contracted space."""
    finest: int = 2048
    """Number of grid cells per side at the finest level."""
    hidden: int = 32
    """Width of the hidden layers of the density and colour networks."""
    occupancy: int = 128
    """Number of cells per side of the occupancy grid."""
    steps: int = 750
    """Number of optimisation steps (Adam)."""
    rays: int = 1536
    """Number of rays per step."""
    samples: int = 32
    """Number of samples per ray."""
    rate: float = 1e-2
    """Initial learning rate. It decays exponentially to a tenth of this value."""
    measured: float = 1.0
    """Weight of the depth loss at pixels whose depth was measured by stereo."""
    continued: float = 0.2
    """Weight of the depth loss at pixels whose depth was extrapolated."""
    distortion: float = 3e-3
    """Weight of the distortion loss of mip-NeRF 360, which makes the density along each ray compact."""

    def __post_init__(self) -> None:
        """Check all fields. Raises ValueError for values out of range."""
        _ = self.grid
        for name in ("hidden", "occupancy", "steps", "rays", "samples"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, got {getattr(self, name)}")
        for name in ("rate", "measured", "continued", "distortion"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: expected 0 or more, got {getattr(self, name)}")

    @property
    def grid(self) -> HashGridShape:
        """Shape of the hash grid."""
        return HashGridShape(self.levels, self.features, self.log2_entries, self.coarsest, self.finest)
