"""The point model, which computes renderable arrays from the points of a frame (4K4D, sec. 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from fourd.base.cameras import Camera
from fourd.reconstruction.background.contraction import CONTRACTED_RADIUS, Contraction
from fourd.reconstruction.model.appearance import (
    BlendHead,
    HarmonicsHead,
    ImageEncoder,
    blend,
    harmonics_colour,
    mix_own_colours,
)
from fourd.reconstruction.model.config import ModelConfig
from fourd.reconstruction.model.geometry import GeometryHead
from fourd.reconstruction.model.kplanes import KPlanes
from fourd.reconstruction.model.residual import ResidualField
from fourd.reconstruction.model.shadow import Shadow, ShadowField
from fourd.reconstruction.model.shared_linear import shared_linear
from fourd.reconstruction.model.sources import OCCLUSION_FALLOFF_SPACINGS, SourceSamples, SourceViews, sample_sources
from fourd.reconstruction.model.spherical_harmonics import SH_TERMS

RGB = 3
LOW_SH_TERMS = 4
"""Number of SH basis functions of degrees 0 and 1."""


@dataclass(frozen=True)
class PointFeatures:
    """Outputs of the heads' first layers for N points, computed from the points' K-Planes features. Each output has the
    shape (N, H) and is the input of a ReLU.

    Attributes:
        geometry: output of the geometry head's first layer.
        blend: output of the blend head's first layer; None if the model has no image-based colour.
        harmonics: output of the harmonics head's first layer; None if the model has no harmonics head.
    """

    geometry: Tensor
    blend: Tensor | None
    harmonics: Tensor | None


@dataclass(frozen=True)
class EvaluatedPoints:
    """N points at one time: their geometry, and the features from which their colour is computed.

    Attributes:
        xyz: (N, 3) positions in world units, with the displacement added.
        radius: (N,) radii in world units.
        density: (N,) densities in (0, 1).
        spacing: (N,) distance between neighbouring points in world units.
        displacement: (N, 3) displacement by the residual field, which ``xyz`` already includes; None if the model has
            no residual field.
        features: outputs of the first layers of the heads; None if the colour is already computed.
        sh: (N, 3, 16) SH coefficients, from the MLP or optimised for each point; None if the model uses no SH. Outside
            training, :meth:`PointModel.harmonics` scales those of degrees 2 and 3, unless the model uses only SH.
        rgb: (N, 3) the points' own colours, which are the same in all views. The colours of the views are mixed with
            ``rgb``; see ``mix_own_colours``. If ``rgb`` is None, only the colours of the views are used.
    """

    xyz: Tensor
    radius: Tensor
    density: Tensor
    spacing: Tensor
    displacement: Tensor | None
    features: PointFeatures | None
    sh: Tensor | None
    rgb: Tensor | None


class PointModel(nn.Module):
    """The networks of the point model, which all frames share. The points of each frame are not stored in
    the model: the caller passes them to :meth:`evaluate`.

    Point positions are (N, 3) float32 in world units. Time is in [0, 1] over the whole capture. The attribute
    ``shadow`` is the field of the shadows that the foreground casts on the background; only the model of a background
    can have one.
    """

    lower: Tensor
    upper: Tensor

    def __init__(
        self,
        config: ModelConfig,
        lower: np.ndarray,
        upper: np.ndarray,
        spacing: float,
        frame_count: int,
        contraction: Contraction | None = None,
    ) -> None:
        """Build an untrained model.

        Args:
            config: layers of the networks, and options for ablations.
            lower: (3,) lower corner of the scene's bounds in world units.
            upper: (3,) upper corner of the bounds.
            spacing: mean distance between neighbouring points in world units.
            frame_count: number of frames of the whole capture; each has one row in the time planes.
            contraction: function that maps unbounded space into the volume of the planes. If None, the planes cover
                only the scene's bounds.
        """
        super().__init__()
        self.config = config
        self.spacing = spacing
        self.contraction = contraction
        self.register_buffer("lower", torch.tensor(lower, dtype=torch.float32))
        self.register_buffer("upper", torch.tensor(upper, dtype=torch.float32))
        sides = (1.0, 1.0, 1.0)
        if contraction is None:
            x, y, z = (float(side) for side in np.asarray(upper) - np.asarray(lower))
            sides = (x, y, z)
        self.planes = KPlanes(config.planes, sides, frame_count)
        features = self.planes.out_features
        self.geometry_head = GeometryHead(features, config)
        self.image_encoder: ImageEncoder | None = None
        self.blend_head: BlendHead | None = None
        self.harmonics_head: HarmonicsHead | None = None
        self.residual: ResidualField | None = None
        self.shadow: ShadowField | None = None
        if config.appearance != "sh":
            self.image_encoder = ImageEncoder(config.image_features, config.encoder_stride)
            self.blend_head = BlendHead(features, config.image_features + RGB, config)
        if config.appearance != "ibr" and config.sh == "mlp":
            self.harmonics_head = HarmonicsHead(features, config)
        if config.residual:
            self.residual = ResidualField(config, sides, frame_count)

    @property
    def sh_base(self) -> float:
        """Constant to which the colour from SH is added: 0.5 (medium grey) if the model uses only SH, and 0 if it uses
        image-based colour."""
        return 0.5 if self.config.appearance == "sh" else 0.0

    @property
    def sh_range(self) -> float:
        """Maximum absolute value of the colour from SH, before :attr:`sh_base` is added. If the model uses only SH, the
        maximum is 0.75 and ``sh_base`` is 0.5, so that the sum can reach every colour in [0, 1]."""
        return 0.75 if self.config.appearance == "sh" else self.config.sh_range

    def evaluate(
        self,
        xyz: Tensor,
        spacing: Tensor,
        time: float,
        *,
        explicit_sh: Tensor | None = None,
        rgb: Tensor | None = None,
    ) -> EvaluatedPoints:
        """Compute positions, radii and densities of points at ``time``. From the result, :meth:`colour` computes the
        points' colours for a viewing camera.

        The result is differentiable, but no gradient flows through the K-Planes features to the positions ``xyz``.

        Args:
            xyz: (N, 3) optimised positions in world units.
            spacing: (N,) distance between neighbouring points in world units. Radii are proportional to the spacing.
            time: time of the frame in [0, 1].
            explicit_sh: (N, 48) optimised SH coefficients; None if an MLP predicts the SH coefficients.
            rgb: (N, 3) the points' own colours; see :class:`EvaluatedPoints`.
        """
        features = self._point_features(xyz, time)
        radius, density = self.geometry_head(features.geometry)
        radius = radius * spacing
        displaced, displacement = self.displace(xyz, time)
        sh = self._sh(features, explicit_sh)
        return EvaluatedPoints(displaced, radius, density, spacing, displacement, features, sh, rgb)

    def colour(
        self,
        points: EvaluatedPoints,
        viewer: Camera,
        sources: SourceViews | None,
        *,
        shadow: Shadow | None = None,
        train_encoder: bool = True,
        is_training: bool = True,
    ) -> Tensor:
        """Compute RGB (N, 3) of points as seen from ``viewer``, not clamped (4K4D, eq. 2).

        Args:
            points: the output of :meth:`evaluate`.
            viewer: the viewing camera.
            sources: the source views nearest to the viewing camera; None if the model uses only SH.
            shadow: the shadow on the points, whose factors multiply the image-based colours. None for no shadow.
            train_encoder: whether the image encoder gets a gradient.
            is_training: whether the colours are used in a training step. If true, the SH coefficients of the points are
                used unchanged. If false, they are scaled as in the export of a scene; see :meth:`harmonics`.
        """
        colour: Tensor | None = None
        if self.blend_head is not None:
            assert sources is not None, "image-based colour needs source views"
            encoded = self.encode_sources(sources, train_encoder=train_encoder)
            samples = sample_sources(points.xyz, sources, encoded, OCCLUSION_FALLOFF_SPACINGS * points.spacing)
            logits = self.blend_logits(points, samples, sources, viewer)
            colours = mix_own_colours(samples.colours, samples.visibility, points.rgb, self.config.own_colour)
            colour = blend(logits, samples.visibility, colours, sources.weights)
            colour = colour if shadow is None else shadow.apply(colour)
        sh = self.harmonics(points, is_training=is_training)
        if sh is not None:
            part = harmonics_colour(sh, unit_directions(points.xyz, viewer), self.sh_range, self.sh_base)
            part = part if shadow is None else shadow.detach_inside(part)
            colour = part if colour is None else colour + part
        assert colour is not None
        return colour

    def coordinates(self, xyz: Tensor, time: float) -> Tensor:
        """Convert world points (N, 3) and a time in [0, 1] to K-Planes coordinates (N, 4) in [-1, 1]."""
        if self.contraction is None:
            space = 2 * (xyz - self.lower) / (self.upper - self.lower) - 1
        else:
            space = self.contraction(xyz) / CONTRACTED_RADIUS
        return torch.cat([space, torch.full_like(space[:, :1], 2 * time - 1)], dim=1)

    def encode_images(self, images: Tensor) -> Tensor | None:
        """Compute features (V, image_features, H / stride, W / stride) of V images (V, 3, H, W). Returns None if the
        model has no image-based colour."""
        return None if self.image_encoder is None else self.image_encoder(images)

    def encode_sources(self, sources: SourceViews, *, train_encoder: bool) -> Tensor | None:
        """Return the features of the source views, which are computed unless ``sources`` has them. The image encoder
        gets a gradient only if ``train_encoder`` is true."""
        if sources.encoded is not None:
            return sources.encoded
        with torch.set_grad_enabled(train_encoder and torch.is_grad_enabled()):
            return self.encode_images(sources.images)

    def displace(self, xyz: Tensor, time: float) -> tuple[Tensor, Tensor | None]:
        """Return the positions (N, 3) with the displacement by the residual field, and the displacement (N, 3), or
        None without a residual field."""
        if self.residual is None:
            return xyz, None
        displacement = self.residual(self.coordinates(xyz, time))
        return xyz + displacement, displacement

    def harmonics(self, points: EvaluatedPoints, *, is_training: bool) -> Tensor | None:
        """Return the SH coefficients (N, 3, 16) of the points, or None if the model uses no SH.

        Outside training, ``high_sh_share`` multiplies the coefficients of degrees 2 and 3, unless the model uses only
        SH.
        """
        if points.sh is None or is_training or self.config.appearance == "sh":
            return points.sh
        low, high = points.sh[..., :LOW_SH_TERMS], points.sh[..., LOW_SH_TERMS:]
        return torch.cat([low, self.config.high_sh_share * high], dim=-1)

    def blend_logits(
        self, points: EvaluatedPoints, samples: SourceSamples, sources: SourceViews, viewer: Camera | None
    ) -> Tensor:
        """Compute the blend logits (V, N) of the source views. ``viewer`` is used only for continuous blending and may
        otherwise be None."""
        assert self.blend_head is not None
        assert points.features is not None
        assert points.features.blend is not None
        directions = None
        if self.config.continuous:
            assert viewer is not None, "continuous blending requires a viewing camera"
            directions = _relative_directions(points.xyz, viewer, sources.cameras)
        return self.blend_head(points.features.blend, samples.channels, directions)

    def _sh(self, features: PointFeatures, explicit_sh: Tensor | None) -> Tensor | None:
        """Return the SH coefficients (N, 3, 16) from the MLP or from ``explicit_sh``, or None if the model uses no
        SH."""
        if self.config.appearance == "ibr":
            return None
        if self.harmonics_head is None:
            assert explicit_sh is not None, "explicit spherical harmonics must be passed with the points"
            return explicit_sh.reshape(-1, 3, SH_TERMS)
        assert features.harmonics is not None
        return self.harmonics_head(features.harmonics)

    def _point_features(self, xyz: Tensor, time: float) -> PointFeatures:
        features = self.planes(self.coordinates(xyz.detach(), time))
        layers = [self.geometry_head.first]
        layers += [] if self.blend_head is None else [self.blend_head.point]
        layers += [] if self.harmonics_head is None else [self.harmonics_head.first]
        hidden = shared_linear(features, layers)
        blend = hidden[1].contiguous() if self.blend_head is not None else None
        return PointFeatures(hidden[0], blend, hidden[-1] if self.harmonics_head is not None else None)


def unit_directions(xyz: Tensor, viewer: Camera) -> Tensor:
    """Compute unit vectors (N, 3) from the centre of the viewing camera to the points."""
    centre = torch.tensor(viewer.centre, dtype=xyz.dtype, device=xyz.device)
    return nn.functional.normalize(xyz - centre, dim=-1)


def _relative_directions(xyz: Tensor, viewer: Camera, cameras: tuple[Camera, ...]) -> Tensor:
    """Compare the direction from the viewing camera to each of N points with the directions from V source cameras to
    the point, as in IBRNet. Let d be the unit vector from the viewing camera to a point, and s the unit vector from a
    source camera to the point. The result (V, N, 4) contains the three components of d - s, then the cosine of the
    angle between d and s."""
    target = unit_directions(xyz, viewer)
    parts = []
    for camera in cameras:
        source = unit_directions(xyz, camera)
        parts.append(torch.cat([target - source, (target * source).sum(-1, keepdim=True)], dim=-1))
    return torch.stack(parts)
