"""Configuration of a training run: model, data, losses, learning rates and budget."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fourd.reconstruction.background.radiance.config import RadianceConfig
from fourd.reconstruction.model.config import ModelConfig, PlanesConfig, require

MAX_POINTS = 1 << 24
"""Maximum number of points in a frame or a background. The OpenGL renderers have the same limit."""


@dataclass(frozen=True)
class LossConfig:
    """Weights of the loss terms (4K4D, eq. 8). A loss term with weight 0 is switched off."""

    image: Literal["mse", "huber"] = "mse"
    """Loss function that compares rendered and true colours."""
    perceptual: float = 1e-3
    """Weight of the LPIPS loss (VGG-16). LPIPS needs installed network weights; if they are missing, the loss 1 - SSIM
    replaces it (see `stand_in`)."""
    stand_in: float = 1e-2
    """Weight of the loss 1 - SSIM, which replaces LPIPS if the network weights of LPIPS are missing."""
    mask: float = 1e-1
    """Weight of the mean squared difference between rendered alpha and matte."""
    residual: float = 1e-3
    """Weight of the mean squared displacement that the residual field (see `model.residual`) adds to the points. The
    displacement is measured in point spacings."""
    high_sh: float = 3e-3
    """Weight of the mean squared SH coefficient of degrees 2 and 3 of the foreground points. Used only with
    `appearance: both`."""
    shadow: float = 1e-2
    """Weight of the mean of (f - 1)^2, where f is the shadow factor of a background point. A factor of 1 means no
    shadow."""
    closed: float = 2e-2
    """Weight of the background's mean squared transmittance in images rendered from viewpoints between the training
    cameras."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name != "image":
                require(value >= 0, f"{name}: expected 0 or more, got {value}")


@dataclass(frozen=True)
class RateConfig:
    """Learning rates of Adam. All rates have a linear warm-up and an exponential decay over the step or time budget."""

    planes: float = 5e-3
    """Learning rate of the K-Planes."""
    mlps: float = 1e-3
    """Learning rate of the MLPs and the image encoder."""
    xyz_spacings: float = 0.6
    """Initial learning rate of point positions, as a fraction of the point spacing."""
    xyz_halving_updates: int = 60
    """Constant H in the factor 1 / (1 + n / H), by which the learning rate of a point's position is multiplied after n
    updates of the point. The factor is 1/2 after H updates and 1/3 after 2 * H updates, and it is applied in addition
    to the exponential decay of all learning rates. If H is 0, there is no such reduction. Without the reduction, points
    that no image constrains would move at random, and longer training would make novel views worse."""
    sh: float = 5e-3
    """Learning rate of explicit spherical harmonics and of the points' own colours (see `model.own_colour`)."""
    final: float = 0.05
    """At the end of the step or time budget, each learning rate has decayed to this fraction of its configured
    value."""
    warm_up: int = 20
    """Number of steps of the linear warm-up of the learning rates."""

    def __post_init__(self) -> None:
        for name in ("planes", "mlps", "xyz_spacings", "sh"):
            value = getattr(self, name)
            require(value >= 0, f"{name}: expected 0 or more, got {value}")
        require(
            self.xyz_halving_updates >= 0, f"xyz_halving_updates: expected 0 or more, got {self.xyz_halving_updates}"
        )
        require(0 < self.final <= 1, f"final: expected a share in (0, 1], got {self.final}")
        require(self.warm_up >= 0, f"warm_up: expected 0 or more, got {self.warm_up}")


@dataclass(frozen=True)
class BackgroundConfig:
    """The static background of a full scene (`scene: full`)."""

    points: int = 200_000
    """Maximum number of background points, not counting the shell. The shell consists of coarse points in the
    directions that no clean plate (image of the empty scene) shows."""
    seeding: Literal["ngp", "sfm"] = "ngp"
    """Source of the background points: `ngp` takes them from a radiance field that is fitted to the clean plates and to
    stereo depths, and `sfm` uses only multi-view stereo, without a radiance field."""
    seeds: Path | None = None
    """PLY file with background points in world units. If a file is given, no points are computed from the clean
    plates."""
    radiance: RadianceConfig = field(default_factory=RadianceConfig)
    """Settings of the radiance field for `seeding: ngp`."""
    planes: PlanesConfig = field(default_factory=lambda: PlanesConfig(levels=4, base_resolution=64, time=False))
    """Settings of the background's K-Planes. A contraction maps unbounded space into the volume that these planes
    cover."""
    joint: bool = True
    """Each training step uses either a frame or a clean plate as ground truth (see `share`). If `joint` is true, steps
    on a frame render and train foreground and background together. If it is false, they render and train only the
    foreground, and the background is trained only in steps on clean plates."""
    share: float = 0.35
    """Fraction of the training steps that use a clean plate (image of the empty scene) as ground truth. The other steps
    use a frame."""
    window_px: int = 256
    """Side length, in pixels, of the square image window that a step on a clean plate renders."""
    margin_px: int = 64
    """Steps on a frame render the matte's bounding box, extended on each side by a random margin of up to this number
    of pixels."""
    xyz_rate: float = 0.02
    """Learning rate of the positions of background points, as a fraction of the point spacing."""
    least_layers: int = 12
    """Smallest value of K in a full scene, where K is the maximum number of points that a training step composites at
    each pixel. Each step samples K between `background.least_layers` and `layers`. A larger `background.least_layers`
    prevents blur on floors that are viewed at a grazing angle, where many points overlap at each pixel. If K is too
    small there, the farthest of these points are missing in the image. Training compensates by enlarging the discs, so
    even more points overlap, and the image becomes blurred."""
    encoder_every: int = 8
    """Update the background's image encoder only in steps that use a clean plate and whose step number is divisible by
    `encoder_every`."""
    shadow: bool = False
    """Learn the shadows and the reflected light that the foreground casts on the background in each frame. Requires a
    model with image-based colour."""

    def __post_init__(self) -> None:
        require(1 <= self.points <= MAX_POINTS, f"points: expected 1 to {MAX_POINTS}, got {self.points}")
        require(0 <= self.share <= 1, f"share: expected 0 to 1, got {self.share}")
        require(self.window_px >= 16, f"window_px: expected at least 16, got {self.window_px}")
        require(self.margin_px >= 0, f"margin_px: expected 0 or more, got {self.margin_px}")
        require(self.xyz_rate >= 0, f"xyz_rate: expected 0 or more, got {self.xyz_rate}")
        require(self.least_layers >= 1, f"least_layers: expected at least 1, got {self.least_layers}")
        require(self.encoder_every >= 1, f"encoder_every: expected at least 1, got {self.encoder_every}")


@dataclass(frozen=True)
class DensifyConfig:
    """Splitting and removal of points in a full scene (`scene: full`)."""

    on: bool = True
    """Split and remove points during training."""
    frame_every: int = 40
    """Number of training steps on a frame after which the points of this frame are densified again. Each densification
    also removes the points that are at least `frame_every` steps old and have never received a gradient."""
    background_every: int = 250
    """Number of training steps on the background after which it is densified again. Each densification also removes the
    background points that are occluded in every clean plate whose image contains them."""
    share: float = 0.1
    """Maximum fraction of the points that are split in one densification."""
    growth: float = 1.25
    """Maximum number of points of a frame or of the background, as a multiple of its initial number of points."""
    until: float = 0.6
    """Fraction of the training budget after which densification ends."""

    def __post_init__(self) -> None:
        require(self.frame_every >= 1, f"frame_every: expected at least 1, got {self.frame_every}")
        require(self.background_every >= 1, f"background_every: expected at least 1, got {self.background_every}")
        require(0 <= self.share <= 1, f"share: expected 0 to 1, got {self.share}")
        require(self.growth >= 1, f"growth: expected at least 1, got {self.growth}")
        require(0 <= self.until <= 1, f"until: expected 0 to 1, got {self.until}")


@dataclass(frozen=True)
class RefineConfig:
    """Corrections of the training cameras' calibration. Corrections of poses and focal lengths are off by default."""

    poses: bool = False
    """Refine camera poses by bundle adjustment before the visual hull is carved, and then by gradient descent while
    training."""
    focal: bool = False
    """Refine focal lengths by bundle adjustment before the visual hull is carved, and then by gradient descent while
    training."""
    colours: bool | None = None
    """Correct the colours of each camera by an affine map, which is measured at matching points before training and
    then learnt. The mean correction over all cameras is the identity. If null, colours are corrected if matching points
    show that the cameras differ."""
    rotation_deg: float = 0.5
    """Assumed standard deviation of a camera's rotation error, in degrees."""
    position: float = 0.003
    """Assumed standard deviation of a camera's position error, as a fraction of the camera's distance from the scene's
    centre."""
    focal_spread: float = 0.002
    """Assumed standard deviation of the focal length's error, as a fraction of the focal length."""
    colour_spread: float = 0.1
    """Assumed standard deviation of each entry of a camera's colour correction."""
    band: float = 0.03
    """Maximum distance of a matched feature from its epipolar line, as a fraction of the longer image side. Matches
    that are farther away are not used. The epipolar line is computed with the given cameras, before bundle
    adjustment."""
    weight: float = 1e-5
    """Loss weight of the sum of (correction / standard deviation)^2 over the corrections of a camera."""
    pose_rate: float = 1e-4
    """Learning rate of pose corrections. Rotations are in radians, and translations are fractions of the camera's
    distance from the scene's centre."""
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
        """True if camera poses or focal lengths are corrected."""
        return self.poses or self.focal


@dataclass(frozen=True)
class SegmentConfig:
    """Segments of a long capture. A segment is a range of frames that has its own model."""

    frames: int | None = None
    """Maximum number of frames of a segment. The budget (`max_steps`, `max_seconds`) applies to each segment separately
    and is not divided among the segments. If null, one model represents all frames."""
    overlap: int = 4
    """Number of frames that two successive segments have in common. In these frames, the scene fades from the earlier
    segment to the later one."""
    warm_start: bool = False
    """Start the networks of each segment from the trained networks of the previous segment."""

    def __post_init__(self) -> None:
        require(self.overlap >= 0, f"overlap: expected 0 or more, got {self.overlap}")
        least = max(2, 3 * self.overlap)
        require(
            self.frames is None or self.frames >= least,
            f"frames: expected at least {least} with an overlap of {self.overlap} frames, got {self.frames}",
        )


@dataclass(frozen=True)
class HeldOutConfig:
    """A camera that training leaves out at first, to measure how well the scene looks from new viewpoints. Runs with
    test views use these instead."""

    on: bool = True
    """Leave one camera out of the first part of training, if the run has no test views and at least 4 training cameras.
    The camera with the nearest neighbours on all sides is chosen."""
    until: float = 0.6
    """Fraction of the training budget after which training also uses the camera that was left out. With 4 or 5 training
    cameras, half of this fraction is used."""

    def __post_init__(self) -> None:
        require(0 < self.until <= 1, f"until: expected more than 0 and at most 1, got {self.until}")


@dataclass(frozen=True)
class TrainConfig:
    """All training settings of a run, saved in the run's config.yaml."""

    model: ModelConfig = field(default_factory=ModelConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    rates: RateConfig = field(default_factory=RateConfig)
    scene: Literal["object", "full"] = "object"
    """Part of the images to reconstruct: `object` is only the foreground that the mattes cover, and `full` is the whole
    image, with a static background."""
    background: BackgroundConfig = field(default_factory=BackgroundConfig)
    """Settings of the background of a full scene."""
    densify: DensifyConfig = field(default_factory=DensifyConfig)
    """Settings of densification in a full scene."""
    refine: RefineConfig = field(default_factory=RefineConfig)
    """Settings of the corrections of the calibration."""
    segments: SegmentConfig = field(default_factory=SegmentConfig)
    """Settings of the segments of a long capture."""
    held_out: HeldOutConfig = field(default_factory=HeldOutConfig)
    """Settings of the camera that training leaves out at first."""
    points: int = 40_000
    """Maximum number of points in each frame."""
    trim_hull: bool = True
    """Remove protruding parts of the visual hull before the initial points are placed. The remaining hull still covers
    all mattes."""
    hull_inset: float = 0.9
    """Distance by which the initial points are moved inwards from the surface of the visual hull, as a multiple of the
    point spacing. Without this inset, the initial silhouettes would be too large, because each point is rendered as a
    disc around its position, and training would first have to shrink them."""
    layers: int = 15
    """Largest value of K, where K is the maximum number of points that a training step composites at each pixel. Each
    step samples K between `least_layers` and `layers`."""
    least_layers: int = 8
    """Smallest value of K, the maximum number of points that a training step composites at each pixel (see `layers`).
    Steps with a small K make surfaces opaque after few layers, which is needed because an exported scene composites
    fewer layers than training does. Full scenes use `background.least_layers` instead of this key."""
    samples: int = 2
    """Number of samples per pixel along rows and along columns while training, from 1 to 4. A pixel is the mean of all
    its samples. One sample per pixel gives ragged contours and a lower PSNR in novel views than 2 x 2 samples."""
    pixel_filter: float = 0.1
    """Weight of a neighbouring pixel in the filter of rendered images, from 0 to 0.25. When a trained or exported scene
    is rendered, the filter replaces the supersampling of training (see `samples`). It is separable, with the weights
    `pixel_filter`, 1 - 2 * `pixel_filter` and `pixel_filter` along rows and columns. If 0, images are not filtered."""
    crop: Literal["mask", "full"] = "mask"
    """Part of each image that is used for training: `mask` selects the matte's bounding box with a margin, and `full`
    selects the whole image."""
    random_background: bool = True
    """Composite prediction and ground truth on a random colour in each step, because on a fixed black background, holes
    in dark surfaces would not increase the loss."""
    encoder_every: int = 2
    """Number of steps between two updates of the image encoder. The encoder's backward pass is expensive, and the
    encoder's weights change slowly."""
    hidden_weight: float = 3e-2
    """In each step, skip the points whose compositing weight does not exceed this value at any pixel of the target
    view. If 0, no points are skipped."""
    keep_in_hull: bool = True
    """Prevent stray points: if a step moves a point such that its projection leaves the foreground's silhouette in the
    target view or in a source view, move it back."""
    smoothing: float = 0.5
    """Strength of surface smoothing, which moves each point towards a plane through its neighbours. Points that are
    closer to their plane than a quarter of the point spacing are not moved. If 0, smoothing is switched off."""
    neighbour_pool: int = 5
    """Size of the pool of views from which each step samples its source views. The pool contains the views nearest to
    the target view. If the pool is larger than the number of source views (`model.neighbours`), some steps use source
    views at wide baselines, which also occur when novel views are rendered."""
    near: float | None = None
    """Depth of the near plane in world units: what is nearer to a camera is not shown. If null, it is half the depth of
    the nearest surface that a camera of the capture sees, and at most a third of the depth of the subject."""
    image_scale: float = 1.0
    """Scale of the images. A scale of 0.5 halves width and height."""
    views: tuple[str, ...] | None = None
    """Names of the cameras to use or, with a minus sign in front of each name, of the cameras to leave out. If null,
    all cameras are used."""
    test_views: tuple[str, ...] | None = None
    """Names of held-out cameras, which are used neither for training nor as source views. If null, the capture's test
    split (`split.json`) is held out, if it has one. An empty list holds out no camera."""
    frames: str | None = None
    """Frames to use, written A:B, or A:B:S to use every S-th frame. Frame B is excluded. If null, all frames are
    used."""
    max_steps: int | None = None
    """Stop after this many steps."""
    max_seconds: float | None = None
    """Stop after this many seconds of training."""
    seed: int = 0
    """Seed of all random numbers of the run."""
    checkpoint_seconds: float = 120.0
    """Seconds between checkpoints. This key is ignored if checkpoint_steps is set."""
    checkpoint_steps: int | None = None
    """Number of steps between checkpoints. If null, checkpoint_seconds is used."""
    validation_seconds: float = 60.0
    """Seconds between validations. Validations use the held-out views, or the camera that is left out at first (see
    `held_out.on`), or training views if no view is held out."""
    memory_mb: int = 96
    """Size of the cache of decoded images in MiB. The cache of points has half this size. Images and points that do not
    fit are read again when they are needed."""

    def __post_init__(self) -> None:
        require(1 <= self.points <= MAX_POINTS, f"points: expected 1 to {MAX_POINTS}, got {self.points}")
        require(self.smoothing >= 0, f"smoothing: expected 0 or more, got {self.smoothing}")
        require(self.hull_inset >= 0, f"hull_inset: expected 0 or more, got {self.hull_inset}")
        require(1 <= self.layers <= 64, f"layers: expected 1 to 64, got {self.layers}")
        require(self.encoder_every >= 1, f"encoder_every: expected at least 1, got {self.encoder_every}")
        require(self.least_layers >= 1, f"least_layers: expected at least 1, got {self.least_layers}")
        require(1 <= self.samples <= 4, f"samples: expected 1 to 4, got {self.samples}")
        require(0 <= self.pixel_filter <= 0.25, f"pixel_filter: expected 0 to 0.25, got {self.pixel_filter}")
        require(self.hidden_weight >= 0, f"hidden_weight: expected 0 or more, got {self.hidden_weight}")
        require(0 < self.image_scale <= 4, f"image_scale: expected more than 0 and at most 4, got {self.image_scale}")
        require(
            self.neighbour_pool >= self.model.neighbours,
            f"neighbour_pool: expected at least model.neighbours ({self.model.neighbours}), got {self.neighbour_pool}",
        )
        require(
            not (self.background.shadow and self.model.appearance == "sh"),
            "background.shadow: expected image-based colour (model.appearance: both or ibr), got sh",
        )
        if self.segments.frames is not None:
            require(
                self.scene == "object",
                "segments.frames: expected scene: object, because all segments of a whole scene would need the same "
                f"background, got {self.scene}",
            )
            require(
                not (self.refine.cameras or self.refine.colours),
                "segments.frames: expected no refinement of cameras or colours, because each segment would refine its "
                "own cameras, got both",
            )
        for name in (
            "near",
            "max_steps",
            "max_seconds",
            "checkpoint_seconds",
            "checkpoint_steps",
            "validation_seconds",
        ):
            value = getattr(self, name)
            require(value is None or value > 0, f"{name}: expected more than 0, got {value}")
        require(self.memory_mb >= 16, f"memory_mb: expected at least 16, got {self.memory_mb}")
