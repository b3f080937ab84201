"""Lenses, which determine the rays of an image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera

Array = NDArray[np.float64]

_POLES = np.radians(60), np.radians(75)
"""Latitudes, in radians, between which the distance of the eyes of a stereo panorama falls to 0."""


@dataclass(frozen=True)
class RayBundle:
    """The rays of an image.

    Attributes:
        origins: (R, 3) world positions.
        directions: (R, 3) world directions, of any length. A point on a ray is ``origin + t * direction``.
        facing: (3,) common normal of the discs that represent the points of a scene, or None if each disc faces the ray
            that hits it.
        pixels: (R,) index of the pixel of each ray, row by row.
        width, height: size of the image in pixels. A pixel without a ray is black.
    """

    origins: Array
    directions: Array
    facing: Array | None
    pixels: NDArray[np.int64]
    width: int
    height: int


@dataclass(frozen=True)
class Pinhole:
    """The plain pinhole camera. Each pixel has ``samples`` x ``samples`` rays."""

    samples: int = 1

    def rays(self, camera: Camera) -> RayBundle:
        """Return the rays of the image of ``camera``."""
        points, pixels = _sample_points(camera, self.samples)
        directions = _through(camera, points)
        origins = np.broadcast_to(camera.centre, directions.shape)
        return RayBundle(origins, directions, camera.forward, pixels, camera.width, camera.height)


@dataclass(frozen=True)
class Fisheye:
    """An equidistant fisheye lens: the distance of a pixel from the image centre is proportional to the angle between
    its ray and the viewing direction.

    Attributes:
        fov_deg: field of view in degrees, above 0 and at most 360: the angle across the largest circle that fits in the
            image. Pixels outside the circle stay black.
        samples: number of rays along each side of a pixel. A pixel has samples * samples rays.
    """

    fov_deg: float = 180.0
    samples: int = 1

    def __post_init__(self) -> None:
        if not 0 < self.fov_deg <= 360:
            raise ValueError(f"fov: expected more than 0 and at most 360 degrees, got {self.fov_deg:g}")

    def rays(self, camera: Camera) -> RayBundle:
        """Return the rays of a fisheye image with the position, axes and image size of ``camera``."""
        points, pixels = _sample_points(camera, self.samples)
        offset = (points - (camera.width / 2, camera.height / 2)) / (min(camera.width, camera.height) / 2)
        distance = np.linalg.norm(offset, axis=1)
        angle = distance * np.radians(self.fov_deg) / 2
        kept = distance <= 1
        scale = np.divide(
            np.sin(angle), distance, out=np.full_like(angle, np.radians(self.fov_deg) / 2), where=distance > 0
        )
        local = np.concatenate([offset * scale[:, None], np.cos(angle)[:, None]], 1)[kept]
        return _from_centre(camera, local, pixels[kept])


@dataclass(frozen=True)
class Panorama:
    """An equirectangular panorama: the columns span 360 degrees around the camera's vertical axis, and the rows span
    180 degrees from top to bottom. The viewing direction is in the middle. VR headset viewers can open equirectangular
    images.

    For one eye of a stereo panorama, the rays of each column start where this eye is while the head looks in the
    direction of the column (omnidirectional stereo, Peleg et al. 2001). Towards the poles, where such images of the two
    eyes do not match, both eyes move to the middle of the head.

    Attributes:
        samples: number of rays along each side of a pixel. A pixel has samples * samples rays.
        eye_right: distance of the eye to the right of the middle of the head, in world units; negative for the left
            eye, 0 for a panorama without stereo.
    """

    samples: int = 1
    eye_right: float = 0.0

    def rays(self, camera: Camera) -> RayBundle:
        """Return the rays of a panorama with the position, axes and image size of ``camera``."""
        points, pixels = _sample_points(camera, self.samples)
        longitude = (points[:, 0] / camera.width - 0.5) * 2 * np.pi
        latitude = (points[:, 1] / camera.height - 0.5) * np.pi
        local = np.stack(
            [np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)], 1
        )
        rays = _from_centre(camera, local, pixels)
        if self.eye_right == 0:
            return rays
        start, end = _POLES
        towards_pole = np.clip((np.abs(latitude) - start) / (end - start), 0, 1)
        offset = self.eye_right * (0.5 + 0.5 * np.cos(np.pi * towards_pole))
        right = np.stack([np.cos(longitude), np.zeros_like(longitude), -np.sin(longitude)], 1)
        return replace(rays, origins=camera.centre + offset[:, None] * right @ camera.rotation)


@dataclass(frozen=True)
class ThinLens:
    """A lens with an aperture: points in the plane at the focus distance are sharp, and other points are blurred.

    Attributes:
        aperture: diameter of the lens in world units, at least 0.
        focus: depth of the plane in focus in world units, above 0.
        rays_per_pixel: number of rays per pixel, at least 1. They are spread over the lens and over the pixel.
        seed: seed of the random positions of the rays, which are the same in all images of a video.
    """

    aperture: float
    focus: float
    rays_per_pixel: int = 32
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.aperture < np.inf:
            raise ValueError(f"aperture: expected a diameter of at least 0, got {self.aperture:g}")
        if not 0 < self.focus < np.inf:
            raise ValueError(f"focus: expected a distance above 0, got {self.focus:g}")
        if self.rays_per_pixel < 1:
            raise ValueError(f"rays per pixel: expected at least 1, got {self.rays_per_pixel}")

    def rays(self, camera: Camera) -> RayBundle:
        """Return the rays of the camera's image. The lens is centred on the camera's position."""
        rng = np.random.default_rng(self.seed)
        corners, pixels = _sample_points(camera, 1)
        bundles = []
        for k in range(self.rays_per_pixel):
            # Samples on the lens lie on a golden-angle spiral, which is turned by a random angle in each pixel, so that
            # the blur has no pattern.
            radius = 0.5 * self.aperture * np.sqrt((k + 0.5) / self.rays_per_pixel)
            angle = k * np.pi * (3 - np.sqrt(5)) + rng.uniform(0, 2 * np.pi, len(corners))
            on_lens = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], 1)
            sharp = self.focus * _through(camera, corners + rng.uniform(-0.5, 0.5, corners.shape))
            offset = on_lens @ camera.rotation
            bundles.append((camera.centre + offset, (sharp - offset) / self.focus))
        origins, directions = (np.concatenate(arrays) for arrays in zip(*bundles, strict=True))
        indices = np.tile(pixels, self.rays_per_pixel)
        return RayBundle(origins, directions, camera.forward, indices, camera.width, camera.height)


Lens = Pinhole | Fisheye | Panorama | ThinLens


def _sample_points(camera: Camera, samples: int) -> tuple[Array, NDArray[np.int64]]:
    """Return the image positions (R, 2) of evenly spaced samples, and the index (R,) of the pixel of each sample."""
    steps = (np.arange(samples) + 0.5) / samples
    columns = (np.arange(camera.width)[:, None] + steps).reshape(-1)
    rows = (np.arange(camera.height)[:, None] + steps).reshape(-1)
    y, x = np.meshgrid(rows, columns, indexing="ij")
    points = np.stack([x, y], -1).reshape(-1, 2)
    whole = points.astype(np.int64)
    return points, whole[:, 1] * camera.width + whole[:, 0]


def _through(camera: Camera, points: Array) -> Array:
    """Return the world directions (R, 3) of the rays through image positions. Each direction has the component 1 along
    the viewing axis."""
    local = np.concatenate([points, np.ones((len(points), 1))], 1) @ np.linalg.inv(camera.intrinsics).T
    return local @ camera.rotation


def _from_centre(camera: Camera, local: Array, pixels: NDArray[np.int64]) -> RayBundle:
    directions = local @ camera.rotation
    origins = np.broadcast_to(camera.centre, directions.shape)
    return RayBundle(origins, directions, None, pixels, camera.width, camera.height)
