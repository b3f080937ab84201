"""The point model: per-frame points in, radius, density and colour out (4K4D, sec. 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from fourd.background.contraction import CONTRACTED_RADIUS, Contraction
from fourd.cameras import Camera
from fourd.model.appearance import BlendHead, HarmonicsHead, ImageEncoder, blend, harmonics_colour
from fourd.model.config import ModelConfig, PlanesConfig
from fourd.model.geometry import GeometryHead
from fourd.model.kplanes import KPlanes
from fourd.model.shadow import Shadow, ShadowField
from fourd.model.shared_linear import shared_linear
from fourd.model.sources import OCCLUSION_FALLOFF_SPACINGS, SourceSamples, SourceViews, sample_sources

RGB = 3


@dataclass(frozen=True)
class PointFeatures:
    """What the planes say of N points, as each head's hidden layer of width H takes it: (N, H), before its ReLU.

    Attributes:
        geometry: for :meth:`PointModel.geometry`.
        blend: for :meth:`PointModel.blend_logits`; None without an image-based part.
        harmonics: for :meth:`PointModel.harmonics`; None where no MLP makes them.
    """

    geometry: Tensor
    blend: Tensor | None
    harmonics: Tensor | None


class PointModel(nn.Module):
    """Everything learnt that all frames share; the points themselves belong to the frames.

    Points are (N, 3) float32 in world units, time is a number in [0, 1]. ``shadow`` is set of a background on which
    what moves casts some.
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
        """Make an untrained model.

        Args:
            config: what to build.
            lower: (3,) lower corner of the scene's bounds in world units.
            upper: (3,) upper corner.
            spacing: mean distance between neighbouring points in world units: radii scale with it.
            frame_count: frames of the whole capture: rows of the time planes.
            contraction: lets the planes hold all of space; without one they end at the bounds.
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
        """Colour that the SH part is added to: mid grey when no images give the base."""
        return 0.5 if self.config.appearance == "sh" else 0.0

    @property
    def sh_range(self) -> float:
        """Half the width of the interval of the SH part; wide enough for all colours on its own."""
        return 0.75 if self.config.appearance == "sh" else self.config.sh_range

    def coordinates(self, xyz: Tensor, time: float) -> Tensor:
        """World points (N, 3) and time in [0, 1] -> (N, 4) in [-1, 1] for the planes."""
        if self.contraction is None:
            space = 2 * (xyz - self.lower) / (self.upper - self.lower) - 1
        else:
            space = self.contraction(xyz) / CONTRACTED_RADIUS
        return torch.cat([space, torch.full_like(space[:, :1], 2 * time - 1)], dim=1)

    def displacement(self, xyz: Tensor, time: float) -> Tensor | None:
        """(N, 3) learnt displacement in world units, or None without the residual field."""
        return None if self.residual is None else self.residual(self.coordinates(xyz, time))

    def point_features(self, xyz: Tensor, time: float) -> PointFeatures:
        """K-Planes features of points (N, 3). Their positions get no gradient through the planes."""
        features = self.planes(self.coordinates(xyz.detach(), time))
        layers = [self.geometry_head.first]
        layers += [] if self.blend_head is None else [self.blend_head.point]
        layers += [] if self.harmonics_head is None else [self.harmonics_head.first]
        hidden = shared_linear(features, layers)
        blend = hidden[1].contiguous() if self.blend_head is not None else None
        return PointFeatures(hidden[0], blend, hidden[-1] if self.harmonics_head is not None else None)

    def geometry(self, features: PointFeatures, spacing: Tensor) -> tuple[Tensor, Tensor]:
        """Radius (N,) in the units of ``spacing`` (N,), distances between neighbours; density (N,) in (0, 1)."""
        radius, density = self.geometry_head(features.geometry)
        return radius * spacing, density

    def encode_images(self, images: Tensor) -> Tensor | None:
        """(V, 3, H, W) -> (V, image_features, H / stride, W / stride), or None without an image-based part."""
        return None if self.image_encoder is None else self.image_encoder(images)

    def harmonics(self, features: PointFeatures, explicit: Tensor | None) -> Tensor | None:
        """(N, 3, 16) SH from the MLP or ``explicit`` (N, 48); None without an SH part."""
        if self.config.appearance == "ibr":
            return None
        if self.harmonics_head is not None:
            assert features.harmonics is not None
            return self.harmonics_head(features.harmonics)
        assert explicit is not None, "explicit spherical harmonics come with the frame's points"
        return explicit.reshape(-1, 3, 16)

    def blend_logits(
        self,
        features: PointFeatures,
        samples: SourceSamples,
        xyz: Tensor,
        sources: SourceViews,
        viewer: Camera | None,
    ) -> Tensor:
        """(V, N) logits of the source views; ``viewer`` matters to continuous blending alone."""
        assert self.blend_head is not None
        assert features.blend is not None
        directions = None
        if self.config.continuous:
            assert viewer is not None, "continuous blending needs the viewing camera"
            directions = _relative_directions(xyz, viewer, sources.cameras)
        return self.blend_head(features.blend, samples.channels, directions)

    def colour(
        self,
        xyz: Tensor,
        features: PointFeatures,
        viewer: Camera,
        sources: SourceViews | None,
        spacing: Tensor,
        explicit: Tensor | None = None,
        *,
        base: Tensor | None = None,
        shadow: Shadow | None = None,
        train_encoder: bool = True,
    ) -> Tensor:
        """RGB of points seen from ``viewer``, (N, 3), not clamped (4K4D, eq. 2).

        Args:
            sources: the N' views nearest to the viewer; None when colour is SH alone.
            spacing: (N,) distances between neighbours, the unit in which points lie behind what a view sees.
            base: (N, 3) what a source view that does not see a point takes for its colour; None leaves the
                view's own.
            shadow: falls on the image-based part, as on the bytes of a baked scene.
            train_encoder: without it the image CNN gets no gradient, which is a third of a step's time.
        """
        colour: Tensor | None = None
        if self.blend_head is not None:
            assert sources is not None, "image-based colour needs source views"
            encoded = sources.encoded
            if encoded is None:
                with torch.set_grad_enabled(train_encoder and torch.is_grad_enabled()):
                    encoded = self.encode_images(sources.images)
            samples = sample_sources(xyz, sources, encoded, OCCLUSION_FALLOFF_SPACINGS * spacing)
            logits = self.blend_logits(features, samples, xyz, sources, viewer)
            colour = blend(logits, samples.trust, samples.colours, base)
            colour = colour if shadow is None else shadow.cast(colour)
        sh = self.harmonics(features, explicit)
        if sh is not None:
            part = harmonics_colour(sh, unit_directions(xyz, viewer), self.sh_range, self.sh_base)
            part = part if shadow is None else shadow.kept(part)
            colour = part if colour is None else colour + part
        assert colour is not None
        return colour


class ResidualField(nn.Module):
    """A small K-Planes and MLP that moves points by at most ``residual_range`` of the scene's size."""

    def __init__(self, config: ModelConfig, sides: tuple[float, ...], frame_count: int) -> None:
        super().__init__()
        planes = PlanesConfig(levels=2, features=config.planes.features, time=config.planes.time)
        assert len(sides) == 3
        self.planes = KPlanes(planes, (sides[0], sides[1], sides[2]), frame_count)
        self.range = config.residual_range * max(sides)
        self.layers = nn.Sequential(
            nn.Linear(self.planes.out_features, config.hidden), nn.ReLU(), nn.Linear(config.hidden, 3)
        )
        last = self.layers[-1]
        assert isinstance(last, nn.Linear)
        nn.init.uniform_(last.weight, -1e-4, 1e-4)
        nn.init.zeros_(last.bias)

    def forward(self, coordinates: Tensor) -> Tensor:
        """(N, 4) in [-1, 1] -> (N, 3) displacement in world units."""
        return self.range * torch.tanh(self.layers(self.planes(coordinates)))


def unit_directions(xyz: Tensor, viewer: Camera) -> Tensor:
    """(N, 3) unit vectors from the viewer's centre to the points."""
    centre = torch.tensor(viewer.centre, dtype=xyz.dtype)
    return nn.functional.normalize(xyz - centre, dim=-1)


def _relative_directions(xyz: Tensor, viewer: Camera, cameras: tuple[Camera, ...]) -> Tensor:
    """(V, N, 4): difference of the viewing and source directions, and their cosine (as in IBRNet)."""
    target = unit_directions(xyz, viewer)
    parts = []
    for camera in cameras:
        source = unit_directions(xyz, camera)
        parts.append(torch.cat([target - source, (target * source).sum(-1, keepdim=True)], dim=-1))
    return torch.stack(parts)
