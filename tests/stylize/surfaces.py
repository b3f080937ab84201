"""Surfaces with known depth and normals for tests of the stylizer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.stylize.parameters import Numbers, StyleParameters, Surface

FOCAL = 200.0


def rays(size: int) -> NDArray[np.float64]:
    """The rays of the pixels of a square picture, (size, size, 3), scaled to depth 1."""
    y, x = (np.mgrid[:size, :size] + 0.5 - size / 2) / FOCAL
    return np.stack([x, y, np.ones_like(x)], 2)


def make_surface(depth: NDArray[np.float64], normal: NDArray[np.float64], colour: object = (200, 120, 60)) -> Surface:
    """Make an opaque surface from depths (H, W) and unit normals. Where the picture shows no surface, the depth is
    infinite."""
    seen = np.isfinite(depth)
    albedo = np.zeros((*depth.shape, 4), np.uint8)
    albedo[seen] = (*np.broadcast_to(colour, 3), 255)  # type: ignore[call-overload]
    packed = np.zeros((*depth.shape, 4), np.uint8)
    packed[..., :3] = np.where(seen[..., None], np.round(127 * normal) + 128, 128)
    packed[..., 3] = np.where(seen, 255, 0)
    return Surface(albedo, np.where(seen, 1 / depth, 0).astype(np.float32), packed)


def make_plane(size: int, normal: tuple[float, float, float], distance: float = 3.0) -> Surface:
    """Make a plane at ``distance`` along the viewing axis that fills the picture."""
    unit = np.asarray(normal) / np.linalg.norm(normal)
    depth = distance * unit[2] / (rays(size) @ unit)
    return make_surface(depth, np.broadcast_to(unit, (size, size, 3)))


def make_sphere(size: int, radius: float = 1.0, distance: float = 3.0) -> Surface:
    """Make a sphere on the viewing axis."""
    ray = rays(size)
    square = (ray * ray).sum(2)
    middle = distance / square
    under = middle**2 - (distance**2 - radius**2) / square
    depth = np.where(under >= 0, middle - np.sqrt(np.maximum(under, 0)), np.inf)
    at = ray * np.where(np.isfinite(depth), depth, 0)[..., None]
    return make_surface(depth, (at - [0, 0, distance]) / radius)


def random_surface(rng: np.random.Generator, height: int, width: int) -> Surface:
    """Make a surface of random bytes. A part of the surface is empty."""
    normal = rng.integers(0, 256, (height, width, 4)).astype(np.uint8)
    normal[..., 3] = rng.choice([0, 100, 255], (height, width), p=[0.2, 0.1, 0.7])
    depth = np.where(normal[..., 3] > 0, rng.uniform(0.2, 1, (height, width)), 0).astype(np.float32)
    return Surface(rng.integers(0, 256, (height, width, 4)).astype(np.uint8), depth, normal)


def numbers_of(size: int, **changes: object) -> Numbers:
    """Make the ``Numbers`` of the stylizer for the camera of :func:`rays`."""
    offset = -size / 2 / FOCAL
    ray = (1 / FOCAL, 0.0, offset, 0.0, 1 / FOCAL, offset)
    return Numbers(ray, (0.0, 0.0, -1.0), **changes)  # type: ignore[arg-type]


def white_table() -> NDArray[np.uint8]:
    """A shade table that changes nothing."""
    return np.full((1, 256, 3), 255, np.uint8)


def line_parameters(size: int, **changes: object) -> StyleParameters:
    """Parameters of black Sobel lines."""
    numbers = {key: changes.pop(key) for key in list(changes) if key in Numbers.__dataclass_fields__}
    return StyleParameters(numbers_of(size, **numbers), white_table(), **{"lines": "sobel", **changes})  # type: ignore[arg-type]
