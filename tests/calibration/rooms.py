"""A textured room of planes, ray traced through cameras with lens distortion."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

HALF_WIDTH, HEIGHT = 2.0, 2.4
TEXELS_PER_M = 220


class Room:
    """A box of 4 m x 4 m x 2.4 m with the floor at z = 0 and z up. Every face has its own random texture."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.faces = [
            (axis, side, _texture(rng)) for axis, sides in ((0, (-1, 1)), (1, (-1, 1)), (2, (0, 1))) for side in sides
        ]

    def picture(self, camera: Camera, oversampling: int = 2) -> Picture:
        """RGB picture (H, W, 3) of the room from inside, with lens distortion. A pixel is the mean of ``oversampling``
        x ``oversampling`` rays."""
        u, v = (
            (np.arange(camera.width * oversampling) + 0.5) / oversampling,
            (np.arange(camera.height * oversampling) + 0.5) / oversampling,
        )
        pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        straight = pixels
        if camera.distortion is not None:
            points, k = pixels.reshape(-1, 1, 2), camera.intrinsics
            straight = cv2.undistortPoints(points, k, camera.distortion, R=None, P=k)[:, 0]
        rays = np.column_stack([straight, np.ones(len(straight))]) @ np.linalg.inv(camera.intrinsics).T
        rays = rays @ camera.rotation
        shape = (camera.height * oversampling, camera.width * oversampling)
        nearest, colours = np.full(len(rays), np.inf), np.zeros((len(rays), 3), np.uint8)
        for axis, side, texture in self.faces:
            level = HEIGHT * side if axis == 2 else HALF_WIDTH * side
            with np.errstate(divide="ignore"):
                distance = (level - camera.centre[axis]) / rays[:, axis]
            front = (distance > 0) & (distance < nearest)
            hit = camera.centre + rays * np.where(front, distance, 0)[:, None]
            across, along = (hit[:, other] for other in range(3) if other != axis)
            texel = [
                (TEXELS_PER_M * (offset + values)).astype(np.float32).reshape(shape)
                for offset, values in ((HALF_WIDTH, across), (0 if axis < 2 else HALF_WIDTH, along))
            ]
            seen = cv2.remap(texture, *texel, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
            colours[front] = seen.reshape(-1, 3)[front]
            nearest[front] = distance[front]
        whole = colours.reshape(*shape, 3)
        return np.asarray(cv2.resize(whole, (camera.width, camera.height), interpolation=cv2.INTER_AREA), np.uint8)


def room_depth(camera: Camera) -> Array:
    """(H, W) depth of the room's faces at the pixel centres, for a camera without distortion."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.intrinsics).T @ camera.rotation
    low, high = (np.array([side * HALF_WIDTH, side * HALF_WIDTH, top]) for side, top in ((-1, 0.0), (1, HEIGHT)))
    with np.errstate(divide="ignore"):
        return np.asarray((np.where(rays > 0, high - camera.centre, low - camera.centre) / rays).min(axis=-1))


def _texture(rng: np.random.Generator) -> Picture:
    """A texture of ellipses with many sizes and random colours."""
    side = round(2 * HALF_WIDTH * TEXELS_PER_M)
    texture = np.full((side, side, 3), 128, np.uint8)
    for size, count in ((60, 150), (25, 700), (10, 3000)):
        for x, y in rng.integers(0, side, size=(count, 2)):
            axes = tuple(int(value) for value in rng.integers(size // 3, size, size=2))
            colour = tuple(int(value) for value in rng.integers(20, 236, size=3))
            cv2.ellipse(texture, (int(x), int(y)), axes, float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
    return texture


def room_cameras(count: int, width: int = 480, height: int = 360, distortion: Array | None = None) -> list[Camera]:
    """Cameras on an arc of 70 degrees inside the room, at two heights, facing one corner."""
    intrinsics = np.array([[0.9 * width, 0, 0.5 * width], [0, 0.9 * width, 0.5 * height], [0, 0, 1]])
    cameras = []
    for index in range(count):
        angle = np.radians(45 + 180 - 35 + 70 * index / max(count - 1, 1))
        centre = np.array([1.7 * np.cos(angle) + 0.4, 1.7 * np.sin(angle) + 0.4, 1.0 + 0.5 * (index % 2)])
        target = np.array([1.3, 1.3, 0.7])
        camera = look_at(centre, target, np.array([0.0, 0.0, 1.0]), intrinsics, width, height)
        cameras.append(Camera(camera.intrinsics, camera.rotation, camera.translation, width, height, distortion))
    return cameras
