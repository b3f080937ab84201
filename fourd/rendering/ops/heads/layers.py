"""The weights and settings of the point model's networks, as the operator receives them."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, fields

from torch import Tensor


@dataclass(frozen=True)
class HeadWeights:
    """Weights (outputs, inputs) and biases (outputs,) of the linear layers, for F features in all, layers of width H, C
    image channels and 48 SH coefficients. The order of the fields is that of ``enum Weight`` in ``csrc/heads/heads.h``.

    Attributes:
        geometry_first: (H, F).
        geometry_second: (H, H).
        geometry_last: (2, H), whose outputs determine radius and density.
        blend_point: (H, F), the part of the blend head's first layer that is the same in all views.
        blend_image: (H, C), the other part of that layer.
        blend_out: (1, H).
        sh_first: (H, F).
        sh_last: (48, H).
    """

    geometry_first: Tensor
    geometry_first_bias: Tensor
    geometry_second: Tensor
    geometry_second_bias: Tensor
    geometry_last: Tensor
    geometry_last_bias: Tensor
    blend_point: Tensor
    blend_point_bias: Tensor
    blend_image: Tensor
    blend_out: Tensor
    blend_out_bias: Tensor
    sh_first: Tensor
    sh_first_bias: Tensor
    sh_last: Tensor
    sh_last_bias: Tensor

    @property
    def tensors(self) -> list[Tensor]:
        return [getattr(self, each.name) for each in fields(self)]


@dataclass(frozen=True)
class TimePlanes:
    """Features that are sampled from planes over one coordinate of space and time, at one time for all N points. They
    are inputs of the first layers, as if they were columns of the features.

    Attributes:
        planes: K planes (rows, samples, features). Rows are spaced evenly over time, samples over the coordinate.
        axes: the coordinate of each plane: 0, 1 or 2.
        columns: the input of the first layers that is the first feature of each plane. The other features of the plane
            follow it.
        coordinates: (N, 4) x, y, z, t in [-1, 1]. Values outside [-1, 1] are clamped. The time is not read.
        time: time of all points in [-1, 1].
    """

    planes: list[Tensor] = field(default_factory=list)
    axes: list[int] = field(default_factory=list)
    columns: list[int] = field(default_factory=list)
    coordinates: Tensor | None = None
    time: float = 0.0


NO_TIME_PLANES = TimePlanes()


@dataclass(frozen=True)
class HeadSettings:
    """Constants of the networks.

    Attributes:
        radius_low: smallest radius in point spacings.
        radius_high: largest radius in point spacings.
        radius_offset: constant that is added to the radius's logit.
        density_offset: constant that is added to the density's logit.
        logit_range: largest absolute value of a blend logit.
        sh_range: largest absolute value of the colour from SH.
        own_share: weight of a point's own colour in the views' colours, in (0, 1), or 0 to mix by visibility.
        min_visibility: visibility weights below this value count as 0.
        centre: position of the viewing camera in world units.
    """

    radius_low: float
    radius_high: float
    radius_offset: float
    density_offset: float
    logit_range: float
    sh_range: float
    own_share: float
    min_visibility: float
    centre: tuple[float, float, float]

    @property
    def numbers(self) -> list[float]:
        *numbers, centre = astuple(self)
        return [*numbers, *centre]
