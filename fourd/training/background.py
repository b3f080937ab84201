"""The static background of a full scene: its model, its points, and the clean plates as source views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from fourd.background.contraction import Contraction
from fourd.background.plates import PlateView
from fourd.cameras import Camera
from fourd.model import PointModel
from fourd.model.sources import SourceViews
from fourd.morton import morton_order
from fourd.ply import ColouredPoints
from fourd.training.cameras.rig import Rig
from fourd.training.config import TrainConfig
from fourd.training.occlusion import SizedPoints, occlusion_depth
from fourd.training.points.frame_points import FramePoints
from fourd.training.points.spacing import point_spacings

SIZE_STEP_PX = 32
"""Padded sides of plates are multiples of this."""
CACHED_STEPS = 100
"""Steps for which a plate's depth and features are reused: both change slowly."""
MAX_DEPTH_BEHIND = 9.0
"""In spacings: a point farther behind the occlusion depth of a plate is hidden in it."""
MIN_RADIUS = 0.6
"""In spacings."""


def create_background(
    points: ColouredPoints, plates: Mapping[int, PlateView], config: TrainConfig, contraction: Contraction
) -> StaticBackground:
    """An untrained background.

    Args:
        points: its initial points; their colours are used where no source view sees them.
        plates: clean plates by camera index.
        config: of the run.
        contraction: maps all of space into the K-Planes.
    """
    order = morton_order(points.xyz)
    xyz, rgb = torch.from_numpy(points.xyz[order]), torch.from_numpy(points.rgb[order]).float() / 255
    spacing = torch.from_numpy(point_spacings(points.xyz[order]))
    centre = np.asarray(contraction.centre)
    _, max_radius = config.model.radius_range
    model = PointModel(
        replace(
            config.model,
            planes=config.background.planes,
            radius_range=(min(MIN_RADIUS, 0.9 * config.model.radius_start), max_radius),
            residual=False,
            sh="mlp",
            continuous=False,
        ),
        centre - contraction.radius,
        centre + contraction.radius,
        float(spacing.median()),
        1,
        contraction,
    )
    if config.background.planes.reduction != "product":
        # Features outside all plates get no gradient: random initial values would remain as noise.
        for plane in model.planes.planes:
            torch.nn.init.zeros_(plane)
    cloud = FramePoints.initial(xyz, spacing, config.model.radius_start, explicit_sh=False, rgb=rgb)
    cloud.is_permanent = outside_all_images(xyz, [plate.camera for plate in plates.values()])
    return StaticBackground(model, cloud, plates)


def outside_all_images(xyz: Tensor, cameras: Sequence[Camera]) -> Tensor:
    """(N,) bool, which points (N, 3) lie in no camera's image. No step observes them, and densification keeps them."""
    outside = np.ones(xyz.shape[0], np.bool_)
    for camera in cameras:
        pixels, depth = camera.project(xyz.double().numpy())
        outside &= ~camera.is_in_image(pixels, depth)
    return torch.from_numpy(outside)


@dataclass(frozen=True)
class _CachedPlate:
    """A plate's occlusion depth (H, W) and encoded features (C, h, w), computed at a step."""

    step: int
    depth: Tensor | None
    encoded: Tensor | None


@dataclass(eq=False)
class StaticBackground:
    """Points that all frames share, and their model. Clean plates are the source views.

    Attributes:
        model: without time planes, in contracted space.
        points: the cloud.
        plates: by the camera's index in the capture, training cameras only.
        rig: the current cameras; None for the plates' own.
    """

    model: PointModel
    points: FramePoints
    plates: Mapping[int, PlateView]
    rig: Rig | None = None
    _step: int = 0
    _cache: dict[int, _CachedPlate] = field(default_factory=dict)

    def count_step(self) -> None:
        """Count a step that changed the points or the model, for the expiry of cached depths and features."""
        self._step += 1

    def camera(self, index: int) -> Camera:
        """The current camera of a plate."""
        return self.plates[index].camera if self.rig is None else self.rig.cameras[index]

    def clear_cache(self) -> None:
        """Drop cached depths and features. A resumed run starts without them, so a checkpoint drops them too."""
        self._cache.clear()

    def hidden_points(self) -> Tensor:
        """(N,) bool, points that no plate sees: outside its image, or occluded."""
        xyz, spacing = self.points.xyz.double().numpy(), self.points.spacing.numpy()
        hidden = np.ones(len(xyz), np.bool_)
        for index in self.plates:
            camera = self.camera(index)
            pixels, depth = camera.project(xyz)
            rows = np.flatnonzero(camera.is_in_image(pixels, depth) & hidden)
            column, row = np.minimum(pixels[rows].astype(np.intp), (camera.width - 1, camera.height - 1)).T
            behind = depth[rows] - occlusion_depth(self.points, camera)[row, column]
            hidden[rows] = behind > MAX_DEPTH_BEHIND * spacing[rows]
        return torch.from_numpy(hidden)

    def sources(
        self, cameras: Sequence[int], *, train_encoder: bool = False, points: SizedPoints | None = None
    ) -> SourceViews:
        """Plates as source views, with cached occlusion depths and features.

        Args:
            cameras: indices of the cameras.
            train_encoder: leave the features out, so that the image encoder runs and gets a gradient.
            points: recompute depths and features from these points.
        """
        images, mattes, padded = self._padded_plates(cameras)
        if points is not None:
            cached = [self._evaluate_plate(points, image, camera) for image, camera in zip(images, padded, strict=True)]
        else:
            cached = [self._cached_plate(*each) for each in zip(cameras, images, padded, strict=True)]
        depths = [plate.depth for plate in cached if plate.depth is not None]
        encoded = [plate.encoded for plate in cached if plate.encoded is not None]
        return SourceViews(
            images,
            mattes,
            torch.stack(depths) if depths else None,
            padded,
            torch.stack(encoded) if encoded and not train_encoder else None,
        )

    def _padded_plates(self, cameras: Sequence[int]) -> tuple[Tensor, Tensor, tuple[Camera, ...]]:
        """Images (V, 3, H, W), mattes (V, H, W) and cameras, of one size for all plates, as the cache requires."""
        plates = [self.plates[index] for index in cameras]
        height = max(_round_up(plate.camera.height) for plate in self.plates.values())
        width = max(_round_up(plate.camera.width) for plate in self.plates.values())
        images = torch.zeros(len(plates), 3, height, width)
        mattes = torch.zeros(len(plates), height, width)
        for k, plate in enumerate(plates):
            rows, columns = plate.seen.shape
            image = torch.tensor(plate.rgb).permute(2, 0, 1) / 255
            images[k, :, :rows, :columns] = image if self.rig is None else self.rig.scene_colours(cameras[k], image)
            mattes[k, :rows, :columns] = torch.tensor(plate.seen).float()
        return images, mattes, tuple(self.camera(index).crop(0, 0, width, height) for index in cameras)

    def _cached_plate(self, index: int, image: Tensor, camera: Camera) -> _CachedPlate:
        cached = self._cache.get(index)
        if cached is None or self._step - cached.step >= CACHED_STEPS:
            cached = self._evaluate_plate(self.points, image, camera)
            self._cache[index] = cached
        return cached

    def _evaluate_plate(self, points: SizedPoints, image: Tensor, camera: Camera) -> _CachedPlate:
        with torch.no_grad():
            encoded = self.model.encode_images(image[None])
        depth = torch.from_numpy(occlusion_depth(points, camera)) if self.model.config.occlusion else None
        return _CachedPlate(self._step, depth, None if encoded is None else encoded[0])


def _round_up(size: int) -> int:
    return -(-size // SIZE_STEP_PX) * SIZE_STEP_PX
