"""Rendering of a calibration board with lens distortion, blur and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.boards import CalibrationBoard, draw_board

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

SUPERSAMPLING = 2
"""Number of samples per pixel along each axis."""
PIXELS_PER_SQUARE = 96
BORDER_SQUARES = 0.5
"""Width of the plain border around the pattern, in squares."""
INK, GROUND, BACKGROUND = 35.0, 215.0, 110.0
"""Grey values of the board's dark parts, of its bright parts, and of the background."""
UNDISTORT_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)


@dataclass(frozen=True, eq=False)
class BoardPose:
    """Pose from board to world coordinates: x_world = rotation @ x_board + translation, in metres."""

    rotation: Array
    translation: Array


@dataclass(frozen=True)
class Optics:
    """Imperfections of a camera.

    Attributes:
        blur_px: standard deviation of the Gaussian blur in pixels.
        noise: standard deviation of the image noise in grey levels.
    """

    blur_px: float = 0.6
    noise: float = 2.5


class BoardRenderer:
    """Renders one board as seen by one camera.

    The ray of each sample is undistorted numerically, and then intersected with the plane of the board. Apart from the
    intended blur and noise, the image has errors only because its pixels have few samples, and because the pattern of
    the board has a limited resolution: 96 texels per side of a square of the pattern.
    """

    def __init__(self, board: CalibrationBoard, camera: Camera, optics: Optics) -> None:
        self.board, self.camera, self.optics = board, camera, optics
        margin = round(BORDER_SQUARES * PIXELS_PER_SQUARE)
        drawn = draw_board(board, PIXELS_PER_SQUARE, margin).astype(np.float32) / 255
        self._texture = (INK + (GROUND - INK) * drawn).astype(np.float32)
        self._margin = margin
        self._rays = _sample_rays(camera)

    def render(self, poses: Sequence[BoardPose], generator: np.random.Generator) -> Picture:
        """Render one image for each of the ``poses``, and return the mean of the images, (H, W) uint8. It shows the
        motion blur of a moving board."""
        exposure = np.mean([self._render_sharp(pose) for pose in poses], axis=0)
        blurred = cv2.GaussianBlur(exposure, (0, 0), self.optics.blur_px)
        noisy = blurred + generator.normal(0, self.optics.noise, blurred.shape)
        return np.clip(np.round(noisy), 0, 255).astype(np.uint8)

    def _render_sharp(self, pose: BoardPose) -> NDArray[np.float32]:
        height, width = self.camera.height, self.camera.width
        whole = np.full((height, width), BACKGROUND, np.float32)
        box = self._bounding_box(pose)
        if box is None:
            return whole
        left, top, right, bottom = box
        rays = self._rays[SUPERSAMPLING * top : SUPERSAMPLING * bottom, SUPERSAMPLING * left : SUPERSAMPLING * right]
        rotation = self.camera.rotation @ pose.rotation
        centre = self.camera.rotation @ pose.translation + self.camera.translation
        # Rays in board coordinates start at the camera's centre. They are scaled such that a step of 1 along a ray
        # changes the camera depth by 1.
        start = -rotation.T @ centre
        directions = rays @ rotation.astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = -start[2] / directions[..., 2]
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(1e6)).astype(np.float32)
        scale = PIXELS_PER_SQUARE / self.board.square_m
        x = (start[0] + depth * directions[..., 0]) * scale + self._margin - 0.5
        y = self._texture.shape[0] - (start[1] + depth * directions[..., 1]) * scale - self._margin - 0.5
        texture = self._texture
        if start[2] < 0 and not self.board.double_sided:
            texture = np.full_like(texture, GROUND)
        samples = cv2.remap(
            texture,
            x.astype(np.float32),
            y.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=BACKGROUND,
        )
        rows, columns = bottom - top, right - left
        whole[top:bottom, left:right] = samples.reshape(rows, SUPERSAMPLING, columns, SUPERSAMPLING).mean(axis=(1, 3))
        return whole

    def _bounding_box(self, pose: BoardPose) -> tuple[int, int, int, int] | None:
        """Return the pixel bounds (left, top, right, bottom) of the region that may show the board, or None if the
        board is not in the image."""
        width, height = self.board.size_m
        border = BORDER_SQUARES * self.board.square_m
        x, y = np.meshgrid(np.linspace(-border, width + border, 9), np.linspace(-border, height + border, 9))
        flat = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
        world = flat @ pose.rotation.T + pose.translation
        in_camera = world @ self.camera.rotation.T + self.camera.translation
        if (in_camera[:, 2] < 1e-3).any():
            return 0, 0, self.camera.width, self.camera.height
        distortion = np.zeros(5) if self.camera.distortion is None else self.camera.distortion
        pixels, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), self.camera.intrinsics, distortion)
        flat_pixels = np.asarray(pixels).reshape(-1, 2)
        low = np.floor(flat_pixels.min(axis=0)).astype(int) - 4
        high = np.ceil(flat_pixels.max(axis=0)).astype(int) + 4
        left, top = np.maximum(low, 0)
        right, bottom = np.minimum(high, (self.camera.width, self.camera.height))
        return (int(left), int(top), int(right), int(bottom)) if left < right and top < bottom else None


def _sample_rays(camera: Camera) -> NDArray[np.float32]:
    """Return the rays (S * H, S * W, 3) through the samples, in camera coordinates and scaled to z = 1. S is the number
    of samples per pixel along each axis."""
    steps = (np.arange(max(camera.width, camera.height) * SUPERSAMPLING) + 0.5) / SUPERSAMPLING
    x, y = np.meshgrid(steps[: camera.width * SUPERSAMPLING], steps[: camera.height * SUPERSAMPLING])
    pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    distortion = np.zeros(5) if camera.distortion is None else camera.distortion
    flat = cv2.undistortPoints(pixels, camera.intrinsics, distortion, criteria=UNDISTORT_STEPS)
    rays = np.concatenate([np.asarray(flat).reshape(-1, 2), np.ones((len(flat), 1))], axis=1)
    return rays.reshape(*x.shape, 3).astype(np.float32)
