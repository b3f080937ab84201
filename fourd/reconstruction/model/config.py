"""Configuration of the point model. Every field is a config key that can be changed for an ablation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

MAX_HIDDEN = 4096
"""Maximum width of the hidden layers."""


def require(condition: bool, message: str) -> None:
    """Raise ValueError(message) if ``condition`` is false. The code that reads config files adds the file name and the
    key to the message."""
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True)
class PlanesConfig:
    """4D K-Planes (Fridovich-Keil et al. 2023): feature planes over pairs of the coordinates x, y, z and t."""

    levels: int = 3
    """Number of levels, from 1 to 8. Each level has a different grid resolution."""
    features: int = 8
    """Channels of each plane."""
    base_resolution: int = 32
    """Grid resolution along the longest side of the bounds at the coarsest level, in samples."""
    multiplier: int = 2
    """Factor by which the resolution increases from each level to the next finer one."""
    reduction: Literal["concat", "sum", "product"] = "concat"
    """How the features of the planes of one level are combined: `concat` as in 4K4D, `product` as in K-Planes, or
    `sum`."""
    time: bool = True
    """Use the planes xt, yt and zt. If false, a point's feature does not depend on time."""

    def __post_init__(self) -> None:
        require(1 <= self.levels <= 8, f"levels: expected 1 to 8, got {self.levels}")
        require(1 <= self.features <= 64, f"features: expected 1 to 64, got {self.features}")
        require(self.base_resolution >= 2, f"base_resolution: expected at least 2, got {self.base_resolution}")
        require(1 <= self.multiplier <= 4, f"multiplier: expected 1 to 4, got {self.multiplier}")


@dataclass(frozen=True)
class ModelConfig:
    """The point model of 4K4D (Xu et al. 2024, sec. 3)."""

    planes: PlanesConfig = field(default_factory=PlanesConfig)
    hidden: int = 64
    """Width of the hidden layers of every MLP."""
    appearance: Literal["both", "ibr", "sh"] = "both"
    """Source of a point's colour: `ibr` blends it from source images, `sh` computes it from spherical harmonics, and
    `both` adds the two colours."""
    sh: Literal["mlp", "explicit"] = "mlp"
    """Source of the SH coefficients: `mlp` predicts them from the point's feature with an MLP, and `explicit` optimises
    48 coefficients for each point of each frame."""
    sh_range: float = 0.25
    """Maximum absolute value of the colour from SH that is added to the image-based colour."""
    high_sh_share: float = 0.8
    """Factor from 0 to 1 that multiplies the SH coefficients of degrees 2 and 3 in rendered and exported scenes, but
    not in training. A factor below 1 gives a higher PSNR in novel views, because these coefficients mainly correct
    errors of the image-based colour in single training views, and the corrections are wrong in other views. In
    training, `loss.high_sh` keeps the coefficients small. The key has no effect with `appearance: sh`, where all colour
    comes from SH."""
    own_colour: float = 0.6
    """Weight of a point's own colour in its image-based colour, at least 0 and less than 1. The own colour is optimised
    for each point of each frame and is the same for all viewing directions. It improves novel views where the colours
    from source images are wrong because geometry or blending is inexact. If 0, points have no own colour."""
    continuous: bool = False
    """Let the blend weights depend on the viewing direction, as in ENeRF. A model with this option cannot be
    exported."""
    neighbours: int = 4
    """Number N' of source views that are blended for a viewing camera."""
    fade_views: bool = True
    """Multiply the blend weights of each source view by 1 - a / b, so that images change smoothly along a camera path.
    The angle a is measured at the scene's focus point, between the directions to the source view and to the viewing
    camera. The limit b is the angle of the nearest source view that is not blended."""
    image_features: int = 8
    """Number of channels of the image encoder's features."""
    encoder_stride: Literal[1, 2] = 2
    """Stride in pixels of the image encoder's features. Stride 1 makes the encoder take four times as long as stride
    2."""
    occlusion: bool = True
    """Reduce the blend weights of a source view for points that are occluded in this view."""
    radius_range: tuple[float, float] = (0.5, 6.0)
    """Minimum and maximum radius of points, as multiples of the mean distance between neighbouring points."""
    radius_start: float = 1.3
    """Radius of every point before training, as a multiple of the mean distance between neighbouring points."""
    residual: bool = False
    """Displace points by a learnt residual field (a small K-Planes model). Export adds the displacement to the point
    positions."""
    residual_range: float = 0.1
    """Maximum displacement of a point by the residual field, as a fraction of the longest side of the bounds."""

    def __post_init__(self) -> None:
        low, high = self.radius_range
        require(1 <= self.hidden <= MAX_HIDDEN, f"hidden: expected 1 to {MAX_HIDDEN}, got {self.hidden}")
        require(self.neighbours >= 1, f"neighbours: expected at least 1, got {self.neighbours}")
        require(
            0 < low < self.radius_start < high,
            f"radius_range: expected 0 < low < radius_start < high, got {self.radius_range}",
        )
        require(0 <= self.own_colour < 1, f"own_colour: expected 0 or more, and less than 1, got {self.own_colour}")
        require(self.sh_range > 0, f"sh_range: expected more than 0, got {self.sh_range}")
        require(0 <= self.high_sh_share <= 1, f"high_sh_share: expected 0 to 1, got {self.high_sh_share}")
