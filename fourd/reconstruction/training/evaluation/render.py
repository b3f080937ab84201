"""Render a trained scene from any camera, without gradients. Validation, evaluation and ``fourd render`` use this
renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.base.cameras import Camera, SelectedViews, select_views
from fourd.reconstruction.training.background import StaticBackground
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.rendering import RenderablePoints, composite
from fourd.reconstruction.training.scenes.full_scene import FullScene
from fourd.reconstruction.training.scenes.scene import TrainingScene
from fourd.reconstruction.training.views import ViewStore
from fourd.rendering.ops.pixel_filter.reference import filter_pixels_reference


@dataclass(frozen=True)
class RenderedView:
    """A rendered view. All arrays are float32. The pixel filter is applied to all arrays except ``depth``.

    Attributes:
        rgb: (H, W, 3) colours on black, clamped to [0, 1].
        alpha: (H, W) opacity in [0, 1].
        depth: (H, W) mean depth of the composited points in world units, 0 where no point covers the pixel.
        foreground: (H, W) the contribution of foreground points to alpha.
    """

    rgb: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]
    foreground: NDArray[np.float32]


class ModelRenderer:
    """Renders frames of a scene. The source views are the images of the training cameras nearest to the viewing
    camera."""

    def __init__(
        self, scene: TrainingScene, training: list[int], focus: NDArray[np.float64], pixel_filter: float = 0.0
    ) -> None:
        """Create a renderer.

        Args:
            scene: the scene with its models and training images.
            training: indices of the training cameras.
            focus: (3,) point in world units at which angles between cameras are measured. The cameras with the smallest
                angles to the viewing camera become the source views.
            pixel_filter: weight of a neighbouring pixel in the filter of rendered images, from 0 to 0.25. If 0, images
                are not filtered.
        """
        self.scene = scene
        self.training = training
        self.focus = focus
        self.pixel_filter = pixel_filter

    @property
    def views(self) -> ViewStore:
        return self.scene.views

    @property
    def background(self) -> StaticBackground | None:
        """The background of a full scene, or None for an object scene."""
        return self.scene.background

    def render(
        self, points: FramePoints, frame: int, camera: Camera, layers: int, exclude: int | None = None
    ) -> RenderedView:
        """Render a frame.

        Args:
            points: points of the frame.
            frame: index into the selected frames.
            camera: the viewing camera.
            layers: maximum number K of points that are composited at each pixel.
            exclude: index of a camera that is not used as a source view. To render a training view, pass the index of
                its camera, so that the view is not blended from its own image.
        """
        return render_view(
            self.evaluate(points, frame, camera, exclude), camera, layers, self.scene.near, self.pixel_filter
        )

    def evaluate(
        self, points: FramePoints, frame: int, camera: Camera, exclude: int | None = None
    ) -> list[RenderablePoints]:
        """Compute the positions, radii, densities and colours of a frame's points from the models, one object per
        cloud. The colours are those that ``camera`` sees. The arguments have the same meaning as in :meth:`render`."""
        return self.scene.evaluate_frame(points, frame, camera, self._nearest(camera, exclude))

    def render_background(self, camera: Camera, layers: int, exclude: int | None = None) -> RenderedView:
        """Render only the background of a full scene, without shadows."""
        assert isinstance(self.scene, FullScene), "expected a full scene, got an object scene, which has no background"
        points = self.scene.evaluate_background(camera, self._nearest(camera, exclude))
        return render_view([points], camera, layers, self.scene.near, self.pixel_filter)

    def _nearest(self, camera: Camera, exclude: int | None) -> SelectedViews:
        candidates = [index for index in self.training if index != exclude]
        cameras = [self.views.rig.cameras[index] for index in candidates]
        model = self.scene.models["model"].config
        views = select_views(camera, cameras, model.neighbours, self.focus, fade=model.fade_views)
        return replace(views, indices=[candidates[i] for i in views.indices])


def render_view(
    clouds: Sequence[RenderablePoints], camera: Camera, layers: int, near: float, pixel_filter: float
) -> RenderedView:
    """Render points whose colours were evaluated for ``camera`` or for a nearby camera. ``near`` is the depth of the
    near plane in world units."""
    with torch.no_grad():
        render = composite(clouds, camera, layers, near)
    images = (render.features[..., :3].clamp(0, 1), render.alpha, render.features[..., 3])
    rgb, alpha, foreground = (filter_pixels_reference(image.cpu().numpy(), pixel_filter) for image in images)
    return RenderedView(rgb, alpha, render.depth.cpu().numpy(), foreground)
