"""What a training run is told: model, data, losses, rates and budget."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fourd.model.config import ModelConfig, PlanesConfig, require
from fourd.seeding.radiance.config import RadianceConfig


@dataclass(frozen=True)
class LossConfig:
    """Weights of the loss's terms (4K4D, eq. 8); 0 switches a term off."""

    image: Literal["mse", "huber"] = "mse"
    """Penalty of colour differences."""
    perceptual: float = 1e-3
    """Weight of LPIPS (VGG-16), where its weights are at hand."""
    stand_in: float = 1e-2
    """Weight of 1 - SSIM, which takes LPIPS's place where its weights are not at hand."""
    mask: float = 1e-1
    """Weight of the squared difference between rendered alpha and matte."""
    residual: float = 1e-3
    """Weight of the mean squared displacement, in units of the point spacing."""

    def __post_init__(self) -> None:
        for name in ("perceptual", "stand_in", "mask", "residual"):
            value = getattr(self, name)
            require(value >= 0, f"{name}: expected 0 or more, got {value}")


@dataclass(frozen=True)
class RateConfig:
    """Learning rates of Adam, decayed exponentially over the step or time budget."""

    planes: float = 5e-3
    """K-Planes."""
    mlps: float = 1e-3
    """MLPs and the image CNN."""
    xyz: float = 2e-3
    """Points, times the scene's size."""
    sh: float = 5e-3
    """Explicit spherical harmonics."""
    final: float = 0.05
    """Share of each rate that is left when the budget ends."""
    warm_up: int = 20
    """Steps over which the rates rise from zero."""

    def __post_init__(self) -> None:
        for name in ("planes", "mlps", "xyz", "sh"):
            value = getattr(self, name)
            require(value >= 0, f"{name}: expected 0 or more, got {value}")
        require(0 < self.final <= 1, f"final: expected a share in (0, 1], got {self.final}")
        require(self.warm_up >= 0, f"warm_up: expected 0 or more, got {self.warm_up}")


@dataclass(frozen=True)
class BackgroundConfig:
    """The static part of a full scene."""

    points: int = 100_000
    """Points of the background, at most; a coarse shell where no plate looks comes on top."""
    seeding: Literal["ngp", "sfm"] = "ngp"
    """How they are found: ngp: a radiance field fitted to the plates, which stereo helps; sfm: stereo alone."""
    seeds: Path | None = None
    """A PLY with your own points of the background, in world units, in place of those found in the plates."""
    radiance: RadianceConfig = field(default_factory=RadianceConfig)
    """Of ngp seeding."""
    planes: PlanesConfig = field(default_factory=lambda: PlanesConfig(time=False))
    """Its K-Planes, over contracted space."""
    share: float = 0.35
    """Share of the steps that look at a plate, and not at a frame."""
    window_px: int = 256
    """Side of the part of a plate that such a step looks at."""
    margin_px: int = 64
    """Up to so much around the matte is looked at in a frame's step."""
    xyz_rate: float = 0.02
    """Learning rate of the background's points, times their spacing."""
    encoder_every: int = 8
    """The background's image CNN learns in every n-th step that looks at a plate."""

    def __post_init__(self) -> None:
        require(self.points >= 1, f"points: expected at least 1, got {self.points}")
        require(0 <= self.share <= 1, f"share: expected 0 to 1, got {self.share}")
        require(self.window_px >= 16, f"window_px: expected at least 16, got {self.window_px}")
        require(self.margin_px >= 0, f"margin_px: expected 0 or more, got {self.margin_px}")
        require(self.xyz_rate >= 0, f"xyz_rate: expected 0 or more, got {self.xyz_rate}")
        require(self.encoder_every >= 1, f"encoder_every: expected at least 1, got {self.encoder_every}")


@dataclass(frozen=True)
class TrainConfig:
    """Everything that decides what a run computes, saved as the run's config.yaml."""

    model: ModelConfig = field(default_factory=ModelConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    rates: RateConfig = field(default_factory=RateConfig)
    scene: Literal["object", "full"] = "object"
    """object: what the mattes hold, on black; full: everything, with a static background."""
    background: BackgroundConfig = field(default_factory=BackgroundConfig)
    """Of a full scene."""
    points: int = 40_000
    """Points of each frame."""
    layers: int = 15
    """Points composited a pixel while training (K)."""
    least_layers: int = 8
    """Each step draws K from this to layers, so that surfaces close within the fewer layers of an exported scene."""
    crop: Literal["mask", "full"] = "mask"
    """Train on the box of the matte with a margin, or on whole images."""
    random_background: bool = True
    """Composite prediction and truth on a random colour each step, so that black hides no holes."""
    encoder_every: int = 2
    """The image CNN learns in every n-th step: its backward pass is dear and it changes slowly."""
    hidden_weight: float = 3e-2
    """Points whose largest weight in the view stays below this are skipped for the step; 0 skips none."""
    keep_in_hull: bool = True
    """Undo steps that take a point out of the silhouette in the views at hand: stops stray points."""
    neighbour_pool: int = 5
    """Source views are drawn from this many nearest ones, so that unseen views are not strange."""
    image_scale: float = 1.0
    """Scale of the images; 0.5 halves both sides."""
    views: tuple[str, ...] | None = None
    """Cameras to use; all when not given."""
    test_views: tuple[str, ...] = ()
    """Cameras held out: neither trained on nor blended from."""
    frames: str | None = None
    """Frames to use as A:B or A:B:S, B not included; all when not given."""
    max_steps: int | None = None
    """Stop after this many steps."""
    max_seconds: float | None = None
    """Stop after this many seconds of training."""
    seed: int = 0
    """Seed of everything random."""
    checkpoint_seconds: float = 120.0
    """Time between checkpoints; ignored when checkpoint_steps is given."""
    checkpoint_steps: int | None = None
    """Steps between checkpoints."""
    validation_seconds: float = 60.0
    """Time between pictures and PSNR of a held-out (or else a training) view."""
    memory_mb: int = 96
    """Bound on decoded images kept; half of it bounds the points kept. The rest is read again when needed."""

    def __post_init__(self) -> None:
        require(self.points >= 1, f"points: expected at least 1, got {self.points}")
        require(1 <= self.layers <= 64, f"layers: expected 1 to 64, got {self.layers}")
        require(self.encoder_every >= 1, f"encoder_every: expected at least 1, got {self.encoder_every}")
        require(self.least_layers >= 1, f"least_layers: expected at least 1, got {self.least_layers}")
        require(self.hidden_weight >= 0, f"hidden_weight: expected 0 or more, got {self.hidden_weight}")
        require(0 < self.image_scale <= 4, f"image_scale: expected more than 0, got {self.image_scale}")
        require(
            self.neighbour_pool >= self.model.neighbours,
            f"neighbour_pool: expected at least model.neighbours ({self.model.neighbours}), got {self.neighbour_pool}",
        )
        for name in ("max_steps", "max_seconds", "checkpoint_seconds", "checkpoint_steps", "validation_seconds"):
            value = getattr(self, name)
            require(value is None or value > 0, f"{name}: expected more than 0, got {value}")
        require(self.memory_mb >= 16, f"memory_mb: expected at least 16, got {self.memory_mb}")
