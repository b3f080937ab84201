"""Held-out cameras fitted to their own pictures, with the scene as it is: how refined scenes are judged.

A scene that was trained with corrected cameras lies where these say, and a held-out camera, which nothing corrected,
looks past it. BARF (Lin et al., ICCV 2021, sec. 4.2) therefore moves each test camera to where its picture fits the
frozen scene before it measures. Here that is direct alignment by the rendered depth (Lucas and Kanade 1981; with the
mean of both pictures' gradients: Benhimane and Malis, IROS 2004), from blurred pictures to sharp ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.capture.layout import sample_indices
from fourd.training.cameras.rig import recoloured
from fourd.training.evaluation.render import Renderer, picture_of
from fourd.training.points.frame_store import FrameStore
from fourd.training.rendering import Part

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

BLURS_PX = (8.0, 4.0, 2.0, 1.0)
STEPS = 12
DAMPING = 1e-3
MOST_FRAMES = 3
SETTLED = 3e-5
"""Radians, and shares of the distance: steps below this end a level."""
LEAST_COVERED = 0.02
TINT_STRENGTH = 1e-3
"""Of the pull of fitted colours towards none, beside the pixels' mean square."""


@dataclass(frozen=True, eq=False)
class FittedView:
    """A held-out camera where its pictures fit the scene best.

    Attributes:
        camera: of the whole picture.
        colours: (3, 4) what it makes of the scene's colours; None where they were not fitted.
        degrees, distance: by how much it was turned, and moved in world units.
    """

    camera: Camera
    colours: Floats | None
    degrees: float
    distance: float

    def picture(self, rgb: Floats, alpha: Floats) -> Floats:
        """Rendered colours (H, W, 3), ``alpha`` (H, W) of them, as this camera shows them."""
        return rgb if self.colours is None else _tinted(self.colours, rgb, alpha)


def fit_test_camera(renderer: Renderer, frames: FrameStore, index: int, layers: int, *, colours: bool) -> FittedView:
    """Fit the pose of camera ``index``, the same for all frames, and its colours if asked, to up to three frames."""
    given = renderer.views.rig.cameras[index]
    fit = _Fit(renderer, frames, index, layers, colours)
    camera = given
    for blur_px in BLURS_PX:
        camera = fit.level(camera, blur_px)
    turn = np.linalg.norm(cv2.Rodrigues(camera.rotation @ given.rotation.T)[0])
    tint = fit.look(camera, BLURS_PX[-1]).colours
    return FittedView(camera, tint, float(np.degrees(turn)), float(np.linalg.norm(camera.centre - given.centre)))


@dataclass(frozen=True, eq=False)
class _Look:
    """What a pose gives: its mean squared error, the normal equations (6, 6) and (6,), and the fitted colours."""

    error: float
    matrix: Array
    right: Array
    colours: Floats | None


class _Fit:
    def __init__(self, renderer: Renderer, frames: FrameStore, index: int, layers: int, colours: bool) -> None:
        self.renderer = renderer
        self.frames = frames
        self.index = index
        self.layers = layers
        self.colours = colours
        self.chosen = sample_indices(frames.frames, MOST_FRAMES)
        self.parts: dict[int, list[Part]] = {}
        self.distance = float(np.linalg.norm(renderer.views.rig.cameras[index].centre - renderer.focus))

    def level(self, camera: Camera, blur_px: float) -> Camera:
        """The camera after some steps of Levenberg and Marquardt's on pictures blurred by ``blur_px``.

        Colours are evaluated once, for where the camera is at first: they change little by what it moves.
        """
        for frame in self.chosen:
            self.parts[frame] = self.renderer.parts(self.frames.get(frame), frame, camera, self.index)
        damping, now = DAMPING, self.look(camera, blur_px)
        for _ in range(STEPS):
            grown = now.matrix + np.diag(damping * np.diag(now.matrix) + 1e-12)
            step = np.asarray(np.linalg.solve(grown, now.right), np.float64)
            trial = self._moved(camera, step)
            after = self.look(trial, blur_px)
            if after.error < now.error:
                camera, now, damping = trial, after, damping / 5
            else:
                damping *= 20
            if float(np.abs(step).max()) < SETTLED:
                break
        return camera

    def look(self, camera: Camera, blur_px: float) -> _Look:
        """Render the chosen frames and compare."""
        pairs = [self._pair(camera, frame, blur_px) for frame in self.chosen]
        tint = _tint(pairs) if self.colours else None
        matrix, right, error, count = np.zeros((6, 6)), np.zeros(6), 0.0, 0
        for pair in pairs:
            shown = pair.rgb if tint is None else _tinted(tint, pair.rgb, pair.alpha)
            residual = shown - pair.truth
            jacobian = _jacobian(shown, pair, self.distance)
            matrix += np.einsum("ihwc,jhwc->ij", jacobian, jacobian, optimize=True)
            right -= np.einsum("ihwc,hwc->i", jacobian, residual, optimize=True)
            error, count = error + float(np.square(residual).sum()), count + residual.size
        return _Look(error / count, matrix, right, tint)

    def _pair(self, camera: Camera, frame: int, blur_px: float) -> _Pair:
        view = self.renderer.views.view(self.index, frame)
        height, width = view.matte.shape
        part = camera.crop(view.left, view.top, width, height)
        picture = picture_of(self.parts[frame], part, self.layers)
        truth = view.target()[0].numpy()
        if self.renderer.background is not None:
            truth = (view.rgb / np.float32(255)).astype(np.float32)
        alpha = _blurred(picture.alpha, blur_px)
        depth = _blurred(picture.depth * picture.alpha, blur_px) / np.maximum(alpha, 1e-6)
        rgb = _blurred(picture.rgb, blur_px)
        return _Pair(rgb, alpha, np.where(alpha > LEAST_COVERED, depth, 0), _blurred(truth, blur_px), part)

    def _moved(self, camera: Camera, step: Array) -> Camera:
        rotation = cv2.Rodrigues(step[:3])[0]
        translation = rotation @ camera.translation + self.distance * step[3:]
        return replace(camera, rotation=rotation @ camera.rotation, translation=translation)


@dataclass(frozen=True, eq=False)
class _Pair:
    """A rendered picture and the true one, both blurred (H, W, 3); depth (H, W) is 0 where nothing is."""

    rgb: Floats
    alpha: Floats
    depth: Floats
    truth: Floats
    camera: Camera


def _jacobian(shown: Floats, pair: _Pair, distance: float) -> Floats:
    """(6, H, W, 3) how the picture changes as the camera turns (radians) and moves (shares of ``distance``)."""
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
    # What moves along the flow shows at a pixel what was before it on the way.
    along_x, along_y = ((_slope(shown, axis) + _slope(pair.truth, axis)) / 2 for axis in (1, 0))
    change = -(along_x * flow_x[..., None] + along_y * flow_y[..., None])
    return np.where((pair.depth > 0)[..., None], change, 0).astype(np.float32)


def _slope(picture: Floats, axis: int) -> Floats:
    return np.asarray(np.gradient(picture, axis=axis), np.float32)


def _blurred(picture: Floats, sigma_px: float) -> Floats:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), np.float32)


def _tint(pairs: Sequence[_Pair]) -> Floats:
    """(3, 4) affine colours that fit the rendered pictures to the true ones; none of it where nothing speaks for it."""
    matrix, right, count = np.zeros((4, 4)), np.zeros((4, 3)), 0
    for pair in pairs:
        given = np.concatenate([pair.rgb, pair.alpha[..., None]], axis=-1).reshape(-1, 4).astype(np.float64)
        off = (pair.truth - pair.rgb).reshape(-1, 3)
        matrix, right, count = matrix + given.T @ given, right + given.T @ off, count + len(given)
    change = np.linalg.solve(matrix + TINT_STRENGTH * count * np.eye(4), right)
    return (np.eye(3, 4) + change.T).astype(np.float32)


def _tinted(colours: Floats, rgb: Floats, alpha: Floats) -> Floats:
    shown = recoloured(torch.from_numpy(colours), torch.from_numpy(rgb), torch.from_numpy(alpha))
    return np.asarray(shown.numpy(), np.float32)
