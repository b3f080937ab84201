"""The static part of a full scene while it is trained or rendered: its model, its points, and the plates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from torch import Tensor

from fourd.background.contraction import Contraction
from fourd.background.plates import PlateView
from fourd.cameras import Camera
from fourd.model import PointModel
from fourd.model.sources import SourceViews
from fourd.morton import morton_order
from fourd.ops.points.arrays import render_points_numpy
from fourd.ply import ColouredPoints
from fourd.training.cameras.rig import Rig
from fourd.training.config import TrainConfig
from fourd.training.points.frame_store import FramePoints
from fourd.training.points.spacing import spacings
from fourd.training.rendering import NEAR

STEP_PX = 32
KEPT_STEPS = 100
"""Depths and features of a plate are used so long: both change slowly."""
SURFACE_LAYERS = 4
MOST_REACH_PX = 16
HIDDEN_BEHIND = 9.0
"""In spacings: a point that lies so far behind what a plate sees has no say in its colours, nor does it show."""
LEAST_RADIUS = 0.6
"""In spacings."""


def create_background(
    seeded: ColouredPoints, plates: Mapping[int, PlateView], config: TrainConfig, contraction: Contraction
) -> StaticBackground:
    """An untrained background of seeded points, which keep their colours where no source view sees them."""
    order = morton_order(seeded.xyz)
    xyz, rgb = torch.from_numpy(seeded.xyz[order]), torch.from_numpy(seeded.rgb[order]).float() / 255
    spacing = torch.from_numpy(spacings(seeded.xyz[order]))
    centre = np.asarray(contraction.centre)
    _, largest = config.model.radius_range
    model = PointModel(
        replace(
            config.model,
            planes=config.background.planes,
            radius_range=(min(LEAST_RADIUS, 0.9 * config.model.radius_start), largest),
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
        # Where no plate looks nothing is learnt, and random features would stay as noise.
        for plane in model.planes.planes:
            torch.nn.init.zeros_(plane)
    points = FramePoints.fresh(xyz, spacing, config.model.radius_start, explicit_sh=False, rgb=rgb)
    points.lasting = out_of_sight(xyz, [plate.camera for plate in plates.values()])
    return StaticBackground(model, points, plates)


def out_of_sight(xyz: Tensor, cameras: Sequence[Camera]) -> Tensor:
    """(N,) bool, which points (N, 3) lie in no camera's picture: what is guessed there shows in no step, and stays."""
    outside = np.ones(xyz.shape[0], np.bool_)
    for camera in cameras:
        pixels, depth = camera.project(xyz.double().numpy())
        outside &= ~camera.is_in_image(pixels, depth)
    return torch.from_numpy(outside)


@dataclass(frozen=True)
class _Seen:
    """What is known of a plate since a step: its points' depth (H, W), and the image CNN's features (C, h, w)."""

    since: int
    depth: Tensor | None
    encoded: Tensor | None


@dataclass(eq=False)
class StaticBackground:
    """A static cloud and its model. Source views are plates, whose depths and features are kept for a while.

    Attributes:
        model: without time planes, in contracted space.
        points: the cloud.
        plates: by the camera's index in the capture, those trained on alone.
        rig: how the cameras stand; None as the plates say.
    """

    model: PointModel
    points: FramePoints
    plates: Mapping[int, PlateView]
    rig: Rig | None = None
    _step: int = 0
    _known: dict[int, _Seen] = field(default_factory=dict)

    def advance(self) -> None:
        """A step has changed the points or the model."""
        self._step += 1

    def camera(self, index: int) -> Camera:
        """The camera of a plate."""
        return self.plates[index].camera if self.rig is None else self.rig.cameras[index]

    def forget(self) -> None:
        """Drop what is kept for a while, as a run that goes on from a checkpoint has to."""
        self._known.clear()

    def hidden(self) -> Tensor:
        """(N,) bool, which points no plate sees: they lie in no picture, or behind what does."""
        xyz, spacing = self.points.xyz.double().numpy(), self.points.spacing.numpy()
        hidden = np.ones(len(xyz), np.bool_)
        for index in self.plates:
            camera = self.camera(index)
            pixels, depth = camera.project(xyz)
            rows = np.flatnonzero(camera.is_in_image(pixels, depth) & hidden)
            column, row = np.minimum(pixels[rows].astype(np.intp), (camera.width - 1, camera.height - 1)).T
            behind = depth[rows] - hiding_depth(self.points, camera)[row, column]
            hidden[rows] = behind > HIDDEN_BEHIND * spacing[rows]
        return torch.from_numpy(hidden)

    def sources(self, cameras: Sequence[int], *, fresh: bool = False, points: FramePoints | None = None) -> SourceViews:
        """Plates (indices of cameras) with what hides points in them.

        Args:
            fresh: leave the features to be learnt.
            points: the cloud as evaluated now, in place of what was kept of it for a while.
        """
        plates = [self.plates[index] for index in cameras]
        # One size for all: what is kept of a plate goes with any others.
        height = max(_rounded_up(plate.camera.height) for plate in self.plates.values())
        width = max(_rounded_up(plate.camera.width) for plate in self.plates.values())
        images = torch.zeros(len(plates), 3, height, width)
        mattes = torch.zeros(len(plates), height, width)
        for k, plate in enumerate(plates):
            rows, columns = plate.seen.shape
            picture = torch.tensor(plate.rgb).permute(2, 0, 1) / 255
            images[k, :, :rows, :columns] = picture if self.rig is None else self.rig.scene_colours(cameras[k], picture)
            mattes[k, :rows, :columns] = torch.tensor(plate.seen).float()
        padded = tuple(self.camera(index).crop(0, 0, width, height) for index in cameras)
        if points is not None:
            known = [self._look(points, image, camera) for image, camera in zip(images, padded, strict=True)]
        else:
            known = [self._kept(*each) for each in zip(cameras, images, padded, strict=True)]
        depths = [seen.depth for seen in known if seen.depth is not None]
        encoded = [seen.encoded for seen in known if seen.encoded is not None]
        return SourceViews(
            images,
            mattes,
            torch.stack(depths) if depths else None,
            padded,
            torch.stack(encoded) if encoded and not fresh else None,
        )

    def _kept(self, index: int, image: Tensor, camera: Camera) -> _Seen:
        known = self._known.get(index)
        if known is None or self._step - known.since >= KEPT_STEPS:
            known = self._look(self.points, image, camera)
            self._known[index] = known
        return known

    def _look(self, points: FramePoints, image: Tensor, camera: Camera) -> _Seen:
        with torch.no_grad():
            encoded = self.model.encode_images(image[None])
        depth = torch.from_numpy(hiding_depth(points, camera)) if self.model.config.occlusion else None
        return _Seen(self._step, depth, None if encoded is None else encoded[0])


def hiding_depth(points: FramePoints, camera: Camera) -> NDArray[np.float32]:
    """(H, W) depth behind which a point of the same surfaces is hidden.

    Points cover discs: on a floor seen at a grazing angle each would hide those behind it, and a camera would see half
    of the points that it shows. So a pixel has the farthest depth within the reach of a disc.
    """
    pixels, depth = camera.project(points.xyz.double().numpy())
    inside = camera.is_in_image(pixels, depth) & (depth > NEAR)
    found = surface_depth(points, camera)
    if not inside.any():
        return found
    radius_px = camera.intrinsics[0, 0] * points.radius.numpy()[inside] / depth[inside]
    reach = min(int(np.ceil(np.median(radius_px))), MOST_REACH_PX)
    farthest = maximum_filter(np.where(np.isfinite(found), found, 0), 2 * reach + 1)
    return np.where(farthest > 0, farthest, np.float32(np.inf)).astype(np.float32)


def surface_depth(points: FramePoints, camera: Camera) -> NDArray[np.float32]:
    """(H, W) depth of the points as last evaluated, infinite where nothing covers half a pixel."""
    ones = np.ones((points.xyz.shape[0], 1), dtype=np.float32)
    _, alpha, depth = render_points_numpy(
        points.xyz.numpy(),
        ones,
        points.radius.numpy(),
        points.density.numpy(),
        camera,
        layers=SURFACE_LAYERS,
        near=NEAR,
    )
    return np.where(alpha > 0.5, depth, np.float32(np.inf)).astype(np.float32)


def _rounded_up(size: int) -> int:
    return -(-size // STEP_PX) * STEP_PX
