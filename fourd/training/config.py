"""What a training run is told: model, data, losses, rates and budget."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fourd.background.radiance.config import RadianceConfig
from fourd.model.config import ModelConfig, PlanesConfig, require


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
    shadow: float = 1e-2
    """Weight of the mean squared difference from 1 of what shadows multiply the background's colours by."""
    closed: float = 2e-2
    """Weight of the squared transparency of a background seen from between its cameras, where no plate looks."""

    def __post_init__(self) -> None:
        for name in ("perceptual", "stand_in", "mask", "residual", "shadow", "closed"):
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

    points: int = 200_000
    """Points of the background, at most; a coarse shell where no plate looks comes on top."""
    seeding: Literal["ngp", "sfm"] = "ngp"
    """How they are found: ngp: a radiance field fitted to the plates, which stereo helps; sfm: stereo alone."""
    seeds: Path | None = None
    """A PLY with your own points of the background, in world units, in place of those found in the plates."""
    radiance: RadianceConfig = field(default_factory=RadianceConfig)
    """Of ngp seeding."""
    planes: PlanesConfig = field(default_factory=lambda: PlanesConfig(time=False))
    """Its K-Planes, over contracted space."""
    joint: bool = True
    """Train what moves before the background, in one picture; without it each learns alone, on black and on plates."""
    share: float = 0.35
    """Share of the steps that look at a plate, and not at a frame."""
    window_px: int = 256
    """Side of the part of a plate that such a step looks at."""
    margin_px: int = 64
    """Up to so much around the matte is looked at in a frame's step."""
    xyz_rate: float = 0.02
    """Learning rate of the background's points, times their spacing."""
    least_layers: int = 12
    """A full scene's steps draw K from this to layers. Fewer cut off floors that are seen at a grazing angle: gradients
    do not see what was cut off and ask for larger discs, of which more are cut off, until all is a blur."""
    encoder_every: int = 8
    """The background's image CNN learns in every n-th step that looks at a plate."""
    shadow: bool = False
    """Let what moves darken or light the background around it, frame by frame. Its colours from images alone can be."""

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
    """More points where the error is, in full scenes."""

    on: bool = True
    """Whether points come and go while training."""
    frame_every: int = 40
    """Steps of a frame between two rounds for its points; one that shows in none of them goes."""
    background_every: int = 250
    """Steps between two rounds for the background's points; one that lies behind others in every plate goes."""
    share: float = 0.1
    """Of the points that a round halves, at most."""
    growth: float = 1.25
    """Most points, times what there were first."""
    until: float = 0.6
    """Share of the budget after which points stay."""

    def __post_init__(self) -> None:
        require(self.frame_every >= 1, f"frame_every: expected at least 1, got {self.frame_every}")
        require(self.background_every >= 1, f"background_every: expected at least 1, got {self.background_every}")
        require(0 <= self.share <= 1, f"share: expected 0 to 1, got {self.share}")
        require(self.growth >= 1, f"growth: expected at least 1, got {self.growth}")
        require(0 <= self.until <= 1, f"until: expected 0 to 1, got {self.until}")


@dataclass(frozen=True)
class RefineConfig:
    """Corrections of the calibration, of the cameras that are trained on; off by default."""

    poses: bool = False
    """Correct where the cameras stand and look: by features before carving, then learnt with everything else."""
    focal: bool = False
    """Correct their focal lengths likewise."""
    colours: bool = False
    """Learn an affine correction of each camera's colours, whose mean over the cameras is none."""
    rotation_deg: float = 0.5
    """How far a camera's rotation may be off: a standard deviation, in degrees."""
    position: float = 0.003
    """The same of its place, as a share of its distance from where the cameras look."""
    focal_spread: float = 0.002
    """The same of its focal length, as a share of that."""
    colour_spread: float = 0.1
    """The same of its colours."""
    band: float = 0.03
    """Features may be so far from the given cameras' epipolar lines, as a share of a picture's longer side."""
    weight: float = 1e-5
    """Weight in the loss of a learnt correction of one standard deviation."""
    pose_rate: float = 1e-4
    """Learning rate of poses: radians, and shares of the distance."""
    focal_rate: float = 5e-5
    """Learning rate of the focal length's logarithm."""
    colour_rate: float = 5e-3
    """Learning rate of the colours' corrections."""

    def __post_init__(self) -> None:
        for name in ("rotation_deg", "position", "focal_spread", "colour_spread", "band"):
            value = getattr(self, name)
            require(value > 0, f"{name}: expected more than 0, got {value}")
        for name in ("weight", "pose_rate", "focal_rate", "colour_rate"):
            value = getattr(self, name)
            require(value >= 0, f"{name}: expected 0 or more, got {value}")

    @property
    def cameras(self) -> bool:
        """Whether the cameras themselves are corrected."""
        return self.poses or self.focal


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
    densify: DensifyConfig = field(default_factory=DensifyConfig)
    """Of a full scene."""
    refine: RefineConfig = field(default_factory=RefineConfig)
    """Corrections of the calibration."""
    points: int = 40_000
    """Points of each frame."""
    layers: int = 15
    """Points composited a pixel while training (K)."""
    least_layers: int = 8
    """Each step draws K from this to layers, so that surfaces close within the fewer layers of an exported scene; in a
    full scene from background.least_layers."""
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
        require(
            not (self.background.shadow and self.model.appearance == "sh"),
            "background.shadow: expected colours from images to cast it on (model.appearance both or ibr), got sh",
        )
        for name in ("max_steps", "max_seconds", "checkpoint_seconds", "checkpoint_steps", "validation_seconds"):
            value = getattr(self, name)
            require(value is None or value > 0, f"{name}: expected more than 0, got {value}")
        require(self.memory_mb >= 16, f"memory_mb: expected at least 16, got {self.memory_mb}")
