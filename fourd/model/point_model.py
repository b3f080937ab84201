"""The point model, which computes renderable arrays from the points of a frame (4K4D, sec. 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from fourd.background.contraction import CONTRACTED_RADIUS, Contraction
from fourd.cameras import Camera
from fourd.model.appearance import BlendHead, HarmonicsHead, ImageEncoder, blend, harmonics_colour
from fourd.model.config import ModelConfig
from fourd.model.geometry import GeometryHead
from fourd.model.kplanes import KPlanes
from fourd.model.residual import ResidualField
from fourd.model.shadow import Shadow, ShadowField
from fourd.model.shared_linear import shared_linear
from fourd.model.sources import OCCLUSION_FALLOFF_SPACINGS, SourceSamples, SourceViews, sample_sources

RGB = 3


@dataclass(frozen=True)
class PointFeatures:
    """Output of each head's first layer for N points, computed from the points' K-Planes features. Each output is (N,
    H), before the ReLU.

    Attributes:
        geometry: output of the geometry head's first layer.
        blend: output of the blend head's first layer; None without image-based colour.
        harmonics: output of the harmonics head's first layer; None if there is no such head.
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
        displacement: (N, 3) displacement by the residual field, contained in ``xyz``; None without a residual field.
        features: hidden features of the heads.
        explicit_sh: (N, 48) optimised SH coefficients; None where an MLP gives them.
        rgb: (N, 3) the points' own colours, passed to ``blend`` as ``base``: the lower a view's visibility weight at a
            point, the more the own colour replaces the view's colour. None uses the views' colours only.
    """

    xyz: Tensor
    radius: Tensor
    density: Tensor
    spacing: Tensor
    displacement: Tensor | None
    features: PointFeatures
    explicit_sh: Tensor | None
    rgb: Tensor | None


class PointModel(nn.Module):
    """The networks that all frames share. Points are stored for each frame, outside this model.

    Points are (N, 3) float32 in world units. Time is in [0, 1]. ``shadow`` is the field of the foreground's shadows on
    the background; only the model of a background has it.
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
            config: layers and ablation switches.
            lower: (3,) lower corner of the scene's bounds in world units.
            upper: (3,) upper corner of the bounds.
            spacing: mean distance between neighbouring points in world units.
            frame_count: number of frames of the whole capture, which is the number of rows of the time planes.
            contraction: function that maps unbounded space into the volume of the planes; with None, the planes cover
                the bounds only.
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
        """Constant colour to which the SH part is added: mid grey for colour from SH alone, 0 with image-based
        colour."""
        return 0.5 if self.config.appearance == "sh" else 0.0

    @property
    def sh_range(self) -> float:
        """Maximum absolute value of the SH part. For colour from SH alone it is 0.75, so that all colours are in
        range."""
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
        """Compute positions, radii and densities of points at ``time``. :meth:`colour` computes their colours for a
        viewer.

        The result is differentiable. The positions ``xyz`` get no gradient through the K-Planes features of geometry
        and appearance.

        Args:
            xyz: (N, 3) optimised positions in world units.
            spacing: (N,) distance between neighbouring points in world units; radii are multiples of it.
            time: in [0, 1].
            explicit_sh: (N, 48) optimised SH coefficients; see :class:`EvaluatedPoints`.
            rgb: (N, 3) the points' own colours; see :class:`EvaluatedPoints`.
        """
        features = self._point_features(xyz, time)
        radius, density = self.geometry_head(features.geometry)
        radius = radius * spacing
        displacement = None if self.residual is None else self.residual(self.coordinates(xyz, time))
        displaced = xyz if displacement is None else xyz + displacement
        return EvaluatedPoints(displaced, radius, density, spacing, displacement, features, explicit_sh, rgb)

    def colour(
        self,
        points: EvaluatedPoints,
        viewer: Camera,
        sources: SourceViews | None,
        *,
        shadow: Shadow | None = None,
        train_encoder: bool = True,
    ) -> Tensor:
        """RGB (N, 3) of points as seen from ``viewer``, not clamped (4K4D, eq. 2).

        Args:
            points: the output of :meth:`evaluate`.
            viewer: the viewing camera.
            sources: the N' views nearest to the viewer; None if colour is SH alone.
            shadow: factors by which the image-based colours are multiplied. An exported scene stores the factors as
                bytes and applies them to image-based colours, too.
            train_encoder: whether the image encoder gets a gradient. A step without this gradient takes a third less
                time.
        """
        colour: Tensor | None = None
        if self.blend_head is not None:
            assert sources is not None, "image-based colour needs source views"
            encoded = sources.encoded
            if encoded is None:
                with torch.set_grad_enabled(train_encoder and torch.is_grad_enabled()):
                    encoded = self.encode_images(sources.images)
            samples = sample_sources(points.xyz, sources, encoded, OCCLUSION_FALLOFF_SPACINGS * points.spacing)
            logits = self.blend_logits(points, samples, sources, viewer)
            colour = blend(logits, samples.visibility, samples.colours, points.rgb)
            colour = colour if shadow is None else shadow.apply(colour)
        sh = self.harmonics(points)
        if sh is not None:
            part = harmonics_colour(sh, unit_directions(points.xyz, viewer), self.sh_range, self.sh_base)
            part = part if shadow is None else shadow.detach_inside(part)
            colour = part if colour is None else colour + part
        assert colour is not None
        return colour

    def coordinates(self, xyz: Tensor, time: float) -> Tensor:
        """K-Planes coordinates (N, 4) in [-1, 1] of world points (N, 3) at a time in [0, 1]."""
        if self.contraction is None:
            space = 2 * (xyz - self.lower) / (self.upper - self.lower) - 1
        else:
            space = self.contraction(xyz) / CONTRACTED_RADIUS
        return torch.cat([space, torch.full_like(space[:, :1], 2 * time - 1)], dim=1)

    def encode_images(self, images: Tensor) -> Tensor | None:
        """Features (V, image_features, H / stride, W / stride) of images (V, 3, H, W); None without image-based
        colour."""
        return None if self.image_encoder is None else self.image_encoder(images)

    def harmonics(self, points: EvaluatedPoints) -> Tensor | None:
        """SH coefficients (N, 3, 16), predicted by the MLP or explicit; None if colour has no SH part."""
        if self.config.appearance == "ibr":
            return None
        if self.harmonics_head is not None:
            assert points.features.harmonics is not None
            return self.harmonics_head(points.features.harmonics)
        assert points.explicit_sh is not None, "explicit spherical harmonics must be passed with the points"
        return points.explicit_sh.reshape(-1, 3, 16)

    def blend_logits(
        self, points: EvaluatedPoints, samples: SourceSamples, sources: SourceViews, viewer: Camera | None
    ) -> Tensor:
        """Blend logits (V, N) of the source views. ``viewer`` is used by continuous blending only and may otherwise be
        None."""
        assert self.blend_head is not None
        assert points.features.blend is not None
        directions = None
        if self.config.continuous:
            assert viewer is not None, "continuous blending requires a viewing camera"
            directions = _relative_directions(points.xyz, viewer, sources.cameras)
        return self.blend_head(points.features.blend, samples.channels, directions)

    def _point_features(self, xyz: Tensor, time: float) -> PointFeatures:
        features = self.planes(self.coordinates(xyz.detach(), time))
        layers = [self.geometry_head.first]
        layers += [] if self.blend_head is None else [self.blend_head.point]
        layers += [] if self.harmonics_head is None else [self.harmonics_head.first]
        hidden = shared_linear(features, layers)
        blend = hidden[1].contiguous() if self.blend_head is not None else None
        return PointFeatures(hidden[0], blend, hidden[-1] if self.harmonics_head is not None else None)


def unit_directions(xyz: Tensor, viewer: Camera) -> Tensor:
    """Unit vectors (N, 3) from the centre of the viewing camera to the points."""
    centre = torch.tensor(viewer.centre, dtype=xyz.dtype)
    return nn.functional.normalize(xyz - centre, dim=-1)


def _relative_directions(xyz: Tensor, viewer: Camera, cameras: tuple[Camera, ...]) -> Tensor:
    """(V, N, 4) difference (3) between viewing direction and source direction, and the cosine (1) of their angle (as in
    IBRNet)."""
    target = unit_directions(xyz, viewer)
    parts = []
    for camera in cameras:
        source = unit_directions(xyz, camera)
        parts.append(torch.cat([target - source, (target * source).sum(-1, keepdim=True)], dim=-1))
    return torch.stack(parts)
