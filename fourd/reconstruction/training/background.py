"""The static background of a full scene: its model, its points and its clean plates (images without the subject)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.base.formats.ply import ColouredPoints
from fourd.reconstruction.background.contraction import Contraction
from fourd.reconstruction.background.plates import PlateView
from fourd.reconstruction.model import PointModel
from fourd.reconstruction.model.sources import SourceViews
from fourd.reconstruction.training.cameras.rig import Rig
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.occlusion import SizedPoints, occlusion_depth
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.spacing import point_spacings
from fourd.rendering.ops.morton import morton_order

SIZE_STEP_PX = 32
"""The width and the height of padded plates are rounded up to a multiple of this number of pixels."""
CACHED_STEPS = 100
"""Number of training steps for which the cached depth and image features of a plate are reused. Reusing them is
possible because they change only slowly during training."""
MAX_DEPTH_BEHIND = 9.0
"""Tolerance of the occlusion test, as a multiple of the point's spacing (its distance to neighbouring points). A point
is occluded in a plate if it lies farther than the tolerance behind the plate's occlusion depth, which is the rendered
depth of the background's surface (see :func:`fourd.reconstruction.training.occlusion.occlusion_depth`)."""
MIN_RADIUS = 0.6
"""Smallest radius of a background point, as a multiple of the point's spacing."""


def create_background(
    points: ColouredPoints,
    plates: Mapping[int, PlateView],
    config: TrainConfig,
    contraction: Contraction,
    near: float,
) -> StaticBackground:
    """Create an untrained background.

    Args:
        points: initial points. The colour of an initial point is used where no source view sees the point.
        plates: camera index -> clean plate.
        config: the run's training config.
        contraction: function that maps unbounded space into the volume of the K-Planes.
        near: depth of the run's near plane in world units.
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
            own_colour=0.0,
            high_sh_share=1.0,
        ),
        centre - contraction.radius,
        centre + contraction.radius,
        float(spacing.median()),
        1,
        contraction,
    )
    if config.background.planes.reduction != "product":
        # The K-Planes start at zero because random values would remain as noise in the cells that no plate shows, which
        # never get a gradient. Planes that are multiplied cannot start at zero, because they would get no gradient.
        for plane in model.planes.planes:
            torch.nn.init.zeros_(plane)
    cloud = FramePoints.initial(xyz, spacing, config.model.radius_start, explicit_sh=False, rgb=rgb)
    cloud.is_permanent = outside_all_images(xyz, [plate.camera for plate in plates.values()])
    return StaticBackground(model, cloud, plates, near)


def outside_all_images(xyz: Tensor, cameras: Sequence[Camera]) -> Tensor:
    """Return an (N,) bool mask that is true for the points of ``xyz`` (N, 3) that lie outside the images of all
    ``cameras``.

    Training never renders these points, so they never get a gradient. Densification removes other points without a
    gradient, but keeps these points.
    """
    outside = np.ones(xyz.shape[0], np.bool_)
    for camera in cameras:
        pixels, depth = camera.project(xyz.double().numpy())
        outside &= ~camera.is_in_image(pixels, depth)
    return torch.from_numpy(outside)


@dataclass(frozen=True)
class _CachedPlate:
    """A plate's occlusion depth (H, W), behind which points are occluded, and its encoded features (C, h, w), both
    computed at step ``step``."""

    step: int
    depth: Tensor | None
    encoded: Tensor | None


@dataclass(eq=False)
class StaticBackground:
    """The background's model and its points, which all frames share. If the model has image-based colour, the colours
    of the points are blended from the clean plates.

    Attributes:
        model: point model without time planes, in contracted space.
        points: the background's points.
        plates: camera index in the capture -> clean plate. Only training cameras have an entry.
        near: depth of the near plane in world units.
        cameras: all cameras of the capture, held-out cameras included.
        static_near: depth before which no point of the background is in the image of one of ``cameras``.
        rig: the current cameras; if None, the cameras stored in ``plates`` are used.
    """

    model: PointModel
    points: FramePoints
    plates: Mapping[int, PlateView]
    near: float
    cameras: tuple[Camera, ...] = ()
    static_near: float = 0.0
    rig: Rig | None = None
    _step: int = 0
    _cache: dict[int, _CachedPlate] = field(default_factory=dict)

    def to(self, device: torch.device) -> None:
        """Move the model and the points to ``device``."""
        self.model.to(device)
        self.points = self.points.to(device)

    def count_step(self) -> None:
        """Count one training step. A plate's cached depth and features expire after CACHED_STEPS training steps."""
        self._step += 1

    def camera(self, index: int) -> Camera:
        """Return the current camera of a plate."""
        return self.plates[index].camera if self.rig is None else self.rig.cameras[index]

    def clear_cache(self) -> None:
        """Drop the cached depths and features of all plates.

        A resumed run starts with an empty cache. To give the same result, an uninterrupted run clears its cache
        whenever it saves a checkpoint.
        """
        self._cache.clear()

    def hidden_points(self) -> Tensor:
        """Return an (N,) bool mask that is true for the points that are hidden in all plates. A point is hidden in a
        plate if it lies outside the plate's image or is occluded in the plate."""
        xyz, spacing = self.points.xyz.cpu().double().numpy(), self.points.spacing.cpu().numpy()
        hidden = np.ones(len(xyz), np.bool_)
        for index in self.plates:
            camera = self.camera(index)
            pixels, depth = camera.project(xyz)
            rows = np.flatnonzero(camera.is_in_image(pixels, depth) & hidden)
            column, row = np.minimum(pixels[rows].astype(np.intp), (camera.width - 1, camera.height - 1)).T
            behind = depth[rows] - occlusion_depth(self.points, camera, self.near).cpu().numpy()[row, column]
            hidden[rows] = behind > MAX_DEPTH_BEHIND * spacing[rows]
        return torch.from_numpy(hidden).to(self.points.xyz.device)

    def sources(
        self, cameras: Sequence[int], *, train_encoder: bool = False, points: SizedPoints | None = None
    ) -> SourceViews:
        """Return the plates of the given cameras as source views, with occlusion depths and image features.

        Args:
            cameras: indices of the cameras.
            train_encoder: whether this step trains the image encoder. If true, the returned views contain no features,
                so that the encoder computes them again with a gradient.
            points: if given, this call computes the occlusion depths from these points and encodes the plates again. If
                None, cached depths and features are used.
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
        """Return images (V, 3, H, W), coverage masks (V, H, W) and cameras of the plates with camera indices
        ``cameras``.

        All plates are padded to the size of the largest plate, so that their depths and features can be stacked into
        one tensor.
        """
        plates = [self.plates[index] for index in cameras]
        height = max(_round_up(plate.camera.height) for plate in self.plates.values())
        width = max(_round_up(plate.camera.width) for plate in self.plates.values())
        device = self.points.xyz.device
        images = torch.zeros(len(plates), 3, height, width, device=device)
        mattes = torch.zeros(len(plates), height, width, device=device)
        for k, plate in enumerate(plates):
            rows, columns = plate.seen.shape
            image = torch.tensor(plate.rgb, device=device).permute(2, 0, 1) / 255
            images[k, :, :rows, :columns] = image if self.rig is None else self.rig.scene_colours(cameras[k], image)
            mattes[k, :rows, :columns] = torch.tensor(plate.seen, device=device).float()
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
        depth = occlusion_depth(points, camera, self.near) if self.model.config.occlusion else None
        return _CachedPlate(self._step, depth, None if encoded is None else encoded[0])


def _round_up(size: int) -> int:
    return -(-size // SIZE_STEP_PX) * SIZE_STEP_PX
