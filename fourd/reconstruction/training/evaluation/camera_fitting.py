"""Align held-out cameras to a trained scene by means of their own images, to evaluate scenes that were trained with
camera refinement.

Camera refinement changes the poses of the training cameras, and the scene moves with them. A held-out camera is not
refined during training, so its pose does not fit the scene exactly. For this reason, BARF (Lin et al., ICCV 2021, sec.
4.2) also optimises each test camera against the frozen scene before it computes metrics.

This module uses direct image alignment with the rendered depth (Lucas and Kanade 1981), first on blurred and then on
sharper images. The image gradient is the mean of the gradients of the rendered and the true image (Benhimane and Malis,
IROS 2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.optimization.levenberg_marquardt import Rules, Trial, minimize
from fourd.reconstruction.training.cameras.rig import recolour
from fourd.reconstruction.training.evaluation.render import ModelRenderer, render_view
from fourd.reconstruction.training.points.frame_store import FrameStore
from fourd.reconstruction.training.rendering import RenderablePoints
from fourd.recording.capture.layout import sample_indices

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

BLURS_PX = (8.0, 4.0, 2.0, 1.0)
RULES = Rules(max_steps=12, max_trials=1, min_relative_decrease=None, decrease=5.0, increase=20.0)
"""A step is as expensive as a linearisation, because both render. For this reason, each of at most 12 steps counts,
whether it is accepted or not."""
MAX_FRAMES = 3
CONVERGED = 3e-5
"""Convergence threshold: the optimization at a blur level ends when all six components of a step are smaller than this
value. The rotation components are in radians, and the translation components are fractions of the camera's distance
from the scene's centre."""
MIN_ALPHA = 0.02
COLOUR_REGULARISATION = 1e-3
"""Regularisation weight per pixel in the least-squares fit of the colour map. It penalises the squared difference
between the colour map and the identity."""


@dataclass(frozen=True, eq=False)
class FittedView:
    """A held-out camera that was aligned with the scene.

    Attributes:
        camera: the aligned camera, for the uncropped image.
        colours: (3, 4) affine map from the scene's colours to the camera's colours; if None, the colours were not
            fitted.
        degrees: angle of the rotation between the given and the aligned camera.
        distance: distance between the given and the aligned camera centre, in world units.
    """

    camera: Camera
    colours: Floats | None
    degrees: float
    distance: float

    def recolour(self, rgb: Floats, alpha: Floats) -> Floats:
        """Map rendered colours (H, W, 3), premultiplied by ``alpha`` (H, W), to the camera's colours."""
        return rgb if self.colours is None else _recolour(self.colours, rgb, alpha)


def fit_test_camera(
    renderer: ModelRenderer, frames: FrameStore, index: int, layers: int, *, colours: bool
) -> FittedView:
    """Fit the pose of a held-out camera to its images of up to three frames.

    Args:
        renderer: the trained scene.
        frames: the points of the trained scene's frames.
        index: index of the camera. One pose is fitted for all frames.
        layers: maximum number K of points that are composited at each pixel.
        colours: whether to fit the camera's colours in addition to its pose.
    """
    given = renderer.views.rig.cameras[index]
    alignment = _Alignment(renderer, frames, index, layers, colours)
    camera = given
    for blur_px in BLURS_PX:
        camera = alignment.optimize(camera, blur_px)
    rotation = np.linalg.norm(cv2.Rodrigues(camera.rotation @ given.rotation.T)[0])
    fitted = alignment.linearize(camera, BLURS_PX[-1]).colours
    return FittedView(camera, fitted, float(np.degrees(rotation)), float(np.linalg.norm(camera.centre - given.centre)))


@dataclass(frozen=True, eq=False)
class _Model:
    """The quadratic model of the image error at one pose.

    Attributes:
        alignment: the images that are aligned.
        camera: the camera with this pose.
        blur_px: blur of the images.
        cost: mean of r^2, where r is the rendered minus the true image.
        matrix: J^T J (6, 6), where J is the Jacobian of the image with respect to the pose.
        right: -J^T r (6,).
        colours: the fitted colour map (3, 4), or None if colours are not fitted.
    """

    alignment: _Alignment
    camera: Camera
    blur_px: float
    cost: float
    matrix: Array
    right: Array
    colours: Floats | None

    def try_step(self, damping: float) -> Trial[_Model]:
        """Move the camera, and render it."""
        damped = self.matrix + np.diag(damping * np.diag(self.matrix) + 1e-12)
        step = np.asarray(np.linalg.solve(damped, self.right), np.float64)
        after = self.alignment.linearize(self.alignment.move(self.camera, step), self.blur_px)
        return Trial(after, after.cost, is_last=float(np.abs(step).max()) < CONVERGED)


class _Alignment:
    def __init__(self, renderer: ModelRenderer, frames: FrameStore, index: int, layers: int, colours: bool) -> None:
        self.renderer = renderer
        self.frames = frames
        self.index = index
        self.layers = layers
        self.fits_colours = colours
        self.selected = sample_indices(frames.frames, MAX_FRAMES)
        self.clouds: dict[int, list[RenderablePoints]] = {}
        self.distance = float(np.linalg.norm(renderer.views.rig.cameras[index].centre - renderer.focus))

    def optimize(self, camera: Camera, blur_px: float) -> Camera:
        """Optimise the camera with Levenberg-Marquardt on images blurred by ``blur_px``.

        The points' colours are evaluated only once, as seen by the given ``camera``, because the camera moves little
        during the optimization.
        """
        for frame in self.selected:
            self.clouds[frame] = self.renderer.evaluate(self.frames.get(frame), frame, camera, self.index)
        # The state is a model, because one rendering gives both the error of a trial and the model there.
        return minimize(lambda model: model, self.linearize(camera, blur_px), RULES).camera

    def linearize(self, camera: Camera, blur_px: float) -> _Model:
        """Render the selected frames at the given pose and build the normal equations."""
        pairs = [self._render_pair(camera, frame, blur_px) for frame in self.selected]
        colours = _fit_colours(pairs) if self.fits_colours else None
        matrix, right, error, count = np.zeros((6, 6)), np.zeros(6), 0.0, 0
        for pair in pairs:
            shown = pair.rgb if colours is None else _recolour(colours, pair.rgb, pair.alpha)
            residual = shown - pair.truth
            jacobian = _jacobian(shown, pair, self.distance)
            matrix += np.einsum("ihwc,jhwc->ij", jacobian, jacobian, optimize=True)
            right -= np.einsum("ihwc,hwc->i", jacobian, residual, optimize=True)
            error, count = error + float(np.square(residual).sum()), count + residual.size
        return _Model(self, camera, blur_px, error / count, matrix, right, colours)

    def _render_pair(self, camera: Camera, frame: int, blur_px: float) -> _Pair:
        view = self.renderer.views.view(self.index, frame)
        height, width = view.matte.shape
        part = camera.crop(view.left, view.top, width, height)
        near, pixel_filter = self.renderer.scene.near, self.renderer.pixel_filter
        rendered = render_view(self.clouds[frame], part, self.layers, near, pixel_filter)
        truth = self.renderer.scene.reference_picture(view)
        alpha = _blur(rendered.alpha, blur_px)
        depth = _blur(rendered.depth * rendered.alpha, blur_px) / np.maximum(alpha, 1e-6)
        rgb = _blur(rendered.rgb, blur_px)
        return _Pair(rgb, alpha, np.where(alpha > MIN_ALPHA, depth, 0), _blur(truth, blur_px), part)

    def move(self, camera: Camera, step: Array) -> Camera:
        rotation = cv2.Rodrigues(step[:3])[0]
        translation = rotation @ camera.translation + self.distance * step[3:]
        return replace(camera, rotation=rotation @ camera.rotation, translation=translation)


@dataclass(frozen=True, eq=False)
class _Pair:
    """A rendered image and a true image (H, W, 3), both blurred, with the rendered alpha and depth (H, W). The depth is
    0 where there is no surface."""

    rgb: Floats
    alpha: Floats
    depth: Floats
    truth: Floats
    camera: Camera


def _jacobian(shown: Floats, pair: _Pair, distance: float) -> Floats:
    """Compute the derivative (6, H, W, 3) of the image with respect to rotation (in radians) and translation (in
    multiples of ``distance``)."""
    height, width = pair.depth.shape
    rows, columns = np.indices((height, width)) + 0.5
    k = pair.camera.intrinsics
    z = np.where(pair.depth > 0, pair.depth, 1).astype(np.float64)
    y = (rows - k[1, 2]) / k[1, 1]
    x = (columns - k[0, 2] - k[0, 1] * y) / k[0, 0]
    zero, one = np.zeros_like(x), np.ones_like(x)
    by_x = np.stack([-x * y, 1 + x * x, -y, distance / z * one, zero, -distance / z * x])
    by_y = np.stack([-1 - y * y, x * y, x, zero, distance / z * one, -distance / z * y])
    flow_x, flow_y = k[0, 0] * by_x + k[0, 1] * by_y, k[1, 1] * by_y
    # Brightness constancy: after an optical flow (u, v), the image I changes by -(u dI/dx + v dI/dy).
    slope_x, slope_y = ((_slope(shown, axis) + _slope(pair.truth, axis)) / 2 for axis in (1, 0))
    change = -(slope_x * flow_x[..., None] + slope_y * flow_y[..., None])
    return np.where((pair.depth > 0)[..., None], change, 0).astype(np.float32)


def _slope(picture: Floats, axis: int) -> Floats:
    return np.asarray(np.gradient(picture, axis=axis), np.float32)


def _blur(picture: Floats, sigma_px: float) -> Floats:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), np.float32)


def _fit_colours(pairs: Sequence[_Pair]) -> Floats:
    """Fit an affine colour map (3, 4) from rendered to true images by regularised least squares."""
    matrix, right, count = np.zeros((4, 4)), np.zeros((4, 3)), 0
    for pair in pairs:
        given = np.concatenate([pair.rgb, pair.alpha[..., None]], axis=-1).reshape(-1, 4).astype(np.float64)
        difference = (pair.truth - pair.rgb).reshape(-1, 3)
        matrix, right, count = matrix + given.T @ given, right + given.T @ difference, count + len(given)
    change = np.linalg.solve(matrix + COLOUR_REGULARISATION * count * np.eye(4), right)
    return (np.eye(3, 4) + change.T).astype(np.float32)


def _recolour(colours: Floats, rgb: Floats, alpha: Floats) -> Floats:
    shown = recolour(torch.from_numpy(colours), torch.from_numpy(rgb), torch.from_numpy(alpha))
    return np.asarray(shown.numpy(), np.float32)
