"""Configuration of a training run: model, data, losses, learning rates and budget."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fourd.background.radiance.config import RadianceConfig
from fourd.model.config import ModelConfig, PlanesConfig, require


@dataclass(frozen=True)
class LossConfig:
    """Weights of the loss terms (4K4D, eq. 8); 0 switches a term off."""

    image: Literal["mse", "huber"] = "mse"
    """Penalty of colour differences."""
    perceptual: float = 1e-3
    """Weight of LPIPS (VGG-16), where its network weights are installed."""
    stand_in: float = 1e-2
    """Weight of 1 - SSIM, which replaces LPIPS where its network weights are missing."""
    mask: float = 1e-1
    """Weight of the mean squared difference between rendered alpha and matte."""
    residual: float = 1e-3
    """Weight of the mean squared displacement, in units of the point spacing."""
    shadow: float = 1e-2
    """Weight of the mean squared difference of the background's shadow factors from 1."""
    closed: float = 2e-2
    """Weight of the background's mean squared transmittance from viewpoints between the training cameras."""

    def __post_init__(self) -> None:
        for name in ("perceptual", "stand_in", "mask", "residual", "shadow", "closed"):
            value = getattr(self, name)
            require(value >= 0, f"{name}: expected 0 or more, got {value}")


@dataclass(frozen=True)
class RateConfig:
    """Learning rates of Adam, with a linear warm-up and exponential decay over the step or time budget."""

    planes: float = 5e-3
    """K-Planes."""
    mlps: float = 1e-3
    """MLPs and the image encoder."""
    xyz: float = 2e-3
    """Positions of points, as a share of the scene's size."""
    sh: float = 5e-3
    """Explicit spherical harmonics, and colours of background points."""
    final: float = 0.05
    """Factor on all rates at the end of the budget."""
    warm_up: int = 20
    """Steps of the linear warm-up."""

    def __post_init__(self) -> None:
        for name in ("planes", "mlps", "xyz", "sh"):
            value = getattr(self, name)
            require(value >= 0, f"{name}: expected 0 or more, got {value}")
        require(0 < self.final <= 1, f"final: expected a share in (0, 1], got {self.final}")
        require(self.warm_up >= 0, f"warm_up: expected 0 or more, got {self.warm_up}")


@dataclass(frozen=True)
class BackgroundConfig:
    """The static background of a full scene."""

    points: int = 200_000
    """Maximum number of background points, without those of the coarse shell in directions that no plate shows."""
    seeding: Literal["ngp", "sfm"] = "ngp"
    """Source of the points: ngp: a radiance field fitted to the plates, with depths from stereo; sfm: stereo alone."""
    seeds: Path | None = None
    """PLY file with background points in world units, used instead of points from the plates."""
    radiance: RadianceConfig = field(default_factory=RadianceConfig)
    """Settings of ngp seeding."""
    planes: PlanesConfig = field(default_factory=lambda: PlanesConfig(time=False))
    """K-Planes of the background, over contracted space."""
    joint: bool = True
    """Render foreground and background in one picture. If false, each is trained alone, on black and on plates."""
    share: float = 0.35
    """Share of the steps that render a clean plate instead of a frame."""
    window_px: int = 256
    """Side in pixels of the square window of the plate that such a step renders."""
    margin_px: int = 64
    """Maximum margin in pixels around the matte's box in steps that render a frame."""
    xyz_rate: float = 0.02
    """Learning rate of the background's positions, as a share of the point spacing."""
    least_layers: int = 12
    """Minimum of the random K in a full scene. With fewer layers, floors at grazing angles are cut off: the gradient,
    blind to the points behind the last layer, enlarges the discs, and more points are cut off, until all is blurred."""
    encoder_every: int = 8
    """Steps that render a plate update the background's image encoder if their number is a multiple of this."""
    shadow: bool = False
    """Learn shadows and reflected light of the foreground on the background, by frame. Needs image-based colour."""

    def __post_init__(self) -> None:
        require(self.points >= 1, f"points: expected at least 1, got {self.points}")
        require(0 <= self.share <= 1, f"share: expected 0 to 1, got {self.share}")
        require(self.window_px >= 16, f"window_px: expected at least 16, got {self.window_px}")
        require(self.margin_px >= 0, f"margin_px: expected 0 or more, got {self.margin_px}")
        require(self.xyz_rate >= 0, f"xyz_rate: expected 0 or more, got {self.xyz_rate}")
        require(self.least_layers >= 1, f"least_layers: expected at least 1, got {self.least_layers}")
        require(self.encoder_every >= 1, f"encoder_every: expected at least 1, got {self.encoder_every}")


@dataclass(frozen=True)
class DensifyConfig:
    """Densification: splitting and removing points, in full scenes."""

    on: bool = True
    """Whether points are split and removed while training."""
    frame_every: int = 40
    """Steps of a frame between two densifications of its points; points unobserved in all of them are removed."""
    background_every: int = 250
    """Steps between two densifications of the background; points that are occluded in every plate are removed."""
    share: float = 0.1
    """Maximum share of the points that one densification splits."""
    growth: float = 1.25
    """Maximum number of points, as a multiple of the initial number."""
    until: float = 0.6
    """Share of the budget after which densification ends."""

    def __post_init__(self) -> None:
        require(self.frame_every >= 1, f"frame_every: expected at least 1, got {self.frame_every}")
        require(self.background_every >= 1, f"background_every: expected at least 1, got {self.background_every}")
        require(0 <= self.share <= 1, f"share: expected 0 to 1, got {self.share}")
        require(self.growth >= 1, f"growth: expected at least 1, got {self.growth}")
        require(0 <= self.until <= 1, f"until: expected 0 to 1, got {self.until}")


@dataclass(frozen=True)
class RefineConfig:
    """Corrections of the training cameras' calibration; off by default."""

    poses: bool = False
    """Refine camera poses: by bundle adjustment before carving, then by gradient descent while training."""
    focal: bool = False
    """Refine focal lengths likewise."""
    colours: bool = False
    """Learn an affine correction of each camera's colours; the mean over the cameras is the identity."""
    rotation_deg: float = 0.5
    """Standard deviation of a camera's rotation error, in degrees."""
    position: float = 0.003
    """Standard deviation of a camera's position error, as a share of its distance from the scene's centre."""
    focal_spread: float = 0.002
    """Standard deviation of the focal length's error, as a share of the focal length."""
    colour_spread: float = 0.1
    """Standard deviation of the entries of the colour correction."""
    band: float = 0.03
    """Maximum distance of matched features from the given cameras' epipolar lines, as a share of the longer side."""
    weight: float = 1e-5
    """Loss weight of the squared corrections, in units of their standard deviations."""
    pose_rate: float = 1e-4
    """Learning rate of poses, in radians and shares of the distance."""
    focal_rate: float = 5e-5
    """Learning rate of the logarithm of the focal length."""
    colour_rate: float = 5e-3
    """Learning rate of the colour corrections."""

    def __post_init__(self) -> None:
        for name in ("rotation_deg", "position", "focal_spread", "colour_spread", "band"):
            value = getattr(self, name)
            require(value > 0, f"{name}: expected more than 0, got {value}")
        for name in ("weight", "pose_rate", "focal_rate", "colour_rate"):
            value = getattr(self, name)
            require(value >= 0, f"{name}: expected 0 or more, got {value}")

    @property
    def cameras(self) -> bool:
        """Whether poses or focal lengths are corrected."""
        return self.poses or self.focal


@dataclass(frozen=True)
class TrainConfig:
    """All settings of a run, saved as its config.yaml."""

    model: ModelConfig = field(default_factory=ModelConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    rates: RateConfig = field(default_factory=RateConfig)
    scene: Literal["object", "full"] = "object"
    """object: the foreground of the mattes, on black; full: the whole picture, with a static background."""
    background: BackgroundConfig = field(default_factory=BackgroundConfig)
    """Background of a full scene."""
    densify: DensifyConfig = field(default_factory=DensifyConfig)
    """Densification in a full scene."""
    refine: RefineConfig = field(default_factory=RefineConfig)
    """Corrections of the calibration."""
    points: int = 40_000
    """Maximum number of points of each frame."""
    layers: int = 15
    """Number K of points composited at each pixel while training."""
    least_layers: int = 8
    """Minimum of K, which is drawn in each step, so that surfaces are opaque within the fewer layers of an exported
    scene. Full scenes use background.least_layers instead."""
    crop: Literal["mask", "full"] = "mask"
    """Train on the matte's bounding box with a margin, or on whole images."""
    random_background: bool = True
    """Composite prediction and truth on a random colour each step: on black, holes in dark surfaces have no error."""
    encoder_every: int = 2
    """The image encoder is updated in every n-th step: its backward pass is expensive, and it changes slowly."""
    hidden_weight: float = 3e-2
    """Points whose largest compositing weight in the view is below this are skipped in a step; 0 skips none."""
    keep_in_hull: bool = True
    """Revert moves of points out of the silhouettes of the step's target and source views; prevents stray points."""
    neighbour_pool: int = 5
    """Source views are drawn from this many nearest views, so that training covers the baselines of unseen views."""
    image_scale: float = 1.0
    """Scale of the images; 0.5 halves width and height."""
    views: tuple[str, ...] | None = None
    """Cameras to use; null for all."""
    test_views: tuple[str, ...] = ()
    """Held-out cameras: neither trained on nor used as source views."""
    frames: str | None = None
    """Frames to use as A:B or A:B:S, B excluded; null for all."""
    max_steps: int | None = None
    """Stop after this many steps."""
    max_seconds: float | None = None
    """Stop after this many seconds of training."""
    seed: int = 0
    """Seed of all random numbers."""
    checkpoint_seconds: float = 120.0
    """Seconds between checkpoints; ignored if checkpoint_steps is set."""
    checkpoint_steps: int | None = None
    """Steps between checkpoints."""
    validation_seconds: float = 60.0
    """Seconds between validations on held-out (or else training) views."""
    memory_mb: int = 96
    """Size of the cache of decoded images in MiB; the cache of points has half of it. The rest is read when needed."""

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
        require(
            not (self.background.shadow and self.model.appearance == "sh"),
            "background.shadow: expected image-based colour (model.appearance both or ibr), got sh",
        )
        for name in ("max_steps", "max_seconds", "checkpoint_seconds", "checkpoint_steps", "validation_seconds"):
            value = getattr(self, name)
            require(value is None or value > 0, f"{name}: expected more than 0, got {value}")
        require(self.memory_mb >= 16, f"memory_mb: expected at least 16, got {self.memory_mb}")
