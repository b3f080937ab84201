"""Ray tracing of the figure with analytic intersections and several rays per pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.synth.figure import Part

Array = NDArray[np.float64]
Box = tuple[int, int, int, int]

SAMPLES = 3
"""Number of rays per pixel along each axis. It is odd, so that one ray passes through the centre of the pixel, where
the depth is measured."""

BAND_SAMPLES = 1 << 20
"""Approximate number of rays that are traced at once. It bounds the memory for large images."""

KEY_LIGHT = np.array([0.45, 0.35, 0.82]) / np.linalg.norm([0.45, 0.35, 0.82])
FILL_LIGHT = np.array([-0.7, -0.5, 0.35]) / np.linalg.norm([-0.7, -0.5, 0.35])
SHININESS = 28.0


@dataclass(frozen=True, eq=False)
class RenderedFigure:
    """A rendered image.

    Attributes:
        rgb: (H, W, 3) uint8 colours.
        mask: (H, W) uint8 fraction of each pixel's rays that hit the figure; 255 means all rays.
        depth: (H, W) uint16 camera depth at the pixel centre, in millimetres; 0 means background.
    """

    rgb: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    depth: NDArray[np.uint16]


def render_figure(parts: Sequence[Part], camera: Camera, plate: Array, gloss: float) -> RenderedFigure:
    """Render the figure in front of a background image.

    Args:
        parts: the posed figure.
        camera: camera of the image.
        plate: (H, W, 3) background, RGB in [0, 1].
        gloss: strength of highlights in [0, 1].
    """
    rgb, coverage, depth = composite_parts(parts, camera, plate, gloss)
    return RenderedFigure(as_uint8(rgb), as_uint8(coverage), as_millimetres(depth))


def composite_parts(parts: Sequence[Part], camera: Camera, plate: Array, gloss: float) -> tuple[Array, Array, Array]:
    """Render parts in front of a background image. Parts may be outside the image, or partly behind the camera, but the
    camera must not be inside a part.

    Returns:
        colours (H, W, 3), RGB; the fraction (H, W) of each pixel's rays that hit a part; and the camera depth (H, W) of
        the parts at the pixel centres in metres, 0 where there is none.
    """
    height, width = camera.height, camera.width
    rgb, coverage, depth = plate.copy(), np.zeros((height, width)), np.zeros((height, width))
    bounded = [(part, _bounding_box(part, camera)) for part in parts]
    parts = [part for part, box in bounded if box[0] < box[2] and box[1] < box[3]]
    boxes = [box for _, box in bounded if box[0] < box[2] and box[1] < box[3]]
    if not parts:
        return rgb, coverage, depth
    left, top = min(box[0] for box in boxes), min(box[1] for box in boxes)
    right, bottom = max(box[2] for box in boxes), max(box[3] for box in boxes)
    rows = max(1, BAND_SAMPLES // max((right - left) * SAMPLES**2, 1))
    for start in range(top, bottom, rows):
        band = (left, start, right, min(start + rows, bottom))
        colour, hit, distance = _trace(parts, boxes, camera, band, gloss)
        rows_of_band = np.s_[start : band[3], left:right]
        band_coverage = average_samples(hit)
        rgb[rows_of_band] = average_samples(colour) + (1 - band_coverage)[..., None] * rgb[rows_of_band]
        coverage[rows_of_band] = band_coverage
        centres = np.s_[SAMPLES // 2 :: SAMPLES, SAMPLES // 2 :: SAMPLES]
        depth[rows_of_band] = np.where(hit[centres] > 0, distance[centres], 0)
    return rgb, coverage, depth


def render_plate(camera: Camera, hue_shift: float) -> Array:
    """Render the empty studio (H, W, 3), RGB in [0, 1]: a tiled floor and a cylindrical wall with a radius of 6 m."""
    sides = np.arange(camera.width * SAMPLES), np.arange(camera.height * SAMPLES)
    u, v = pixel_rays(camera, *((side + 0.5) / SAMPLES for side in sides))
    rotation = camera.rotation
    x, y, z = (u[None, :] * rotation[0, k] + v[:, None] * rotation[1, k] + rotation[2, k] for k in range(3))
    eye = camera.centre
    along, across = x * x + y * y, eye[0] * x + eye[1] * y
    wall = (-across + np.sqrt(across**2 - along * (eye[0] ** 2 + eye[1] ** 2 - 36.0))) / along
    floor = np.where(z < -1e-9, -eye[2] / np.minimum(z, -1e-9), np.inf)
    t = np.minimum(wall, floor)
    x, y, z = eye[0] + t * x, eye[1] + t * y, eye[2] + t * z
    tiles = np.clip(0.5 + 2.0 * np.sin(np.pi * x / 0.7) * np.sin(np.pi * y / 0.7), 0, 1)
    ground = (0.42 + 0.07 * tiles) * np.exp(-0.018 * (x * x + y * y))
    ring = 0.03 * np.sin(3 * np.arctan2(y, x) + hue_shift)
    backdrop = 0.36 + 0.07 * np.clip(z, 0, 4) + ring
    light = np.where(floor < wall, ground, backdrop)
    tint = np.where(floor < wall, 0.06, -0.07) * (1 + 0.3 * np.sin(hue_shift))
    return average_samples(np.stack([light * (1 + tint), light, light * (1 - tint)], axis=-1))


def _trace(
    parts: Sequence[Part], boxes: Sequence[Box], camera: Camera, band: Box, gloss: float
) -> tuple[Array, Array, Array]:
    """Trace the rays of a band of pixels.

    Returns:
        for each ray, the premultiplied colour (h, w, 3), the hit (h, w) and the camera depth (h, w) in metres. A hit is
        1 if the ray meets the figure, and 0 otherwise.
    """
    left, top, right, bottom = band
    u, v = pixel_rays(
        camera,
        left + (np.arange((right - left) * SAMPLES) + 0.5) / SAMPLES,
        top + (np.arange((bottom - top) * SAMPLES) + 0.5) / SAMPLES,
    )
    nearest = np.full((len(v), len(u)), np.inf)
    part_index = np.full(nearest.shape, -1, dtype=np.int16)
    windows = []
    for index, (part, box) in enumerate(zip(parts, boxes, strict=True)):
        rows = slice(*(SAMPLES * (min(max(edge, top), bottom) - top) for edge in (box[1], box[3])))
        columns = slice(SAMPLES * (box[0] - left), SAMPLES * (box[2] - left))
        windows.append((rows, columns))
        t = _intersect(part, camera, u[columns], v[rows])
        # A ray whose line enters the part behind the camera misses the part.
        closer = (t > 0) & (t < nearest[rows, columns])
        np.copyto(nearest[rows, columns], t, where=closer)
        np.copyto(part_index[rows, columns], np.int16(index), where=closer)
    colour = np.zeros((*nearest.shape, 3))
    for index, (part, (rows, columns)) in enumerate(zip(parts, windows, strict=True)):
        i, j = np.nonzero(part_index[rows, columns] == index)
        if len(i):
            i, j = i + rows.start, j + columns.start
            direction = np.stack([u[j], v[i], np.ones(len(i))], axis=1) @ camera.rotation
            colour[i, j] = _shade(part, camera.centre, direction, nearest[i, j], gloss)
    return colour, (part_index >= 0).astype(np.float64), nearest


def _intersect(part: Part, camera: Camera, u: Array, v: Array) -> Array:
    """Return the camera depths (len(v), len(u)) at which the rays (u, v, 1) enter the part, or infinity for rays that
    miss it.

    In its own coordinates before scaling, the part is a convex rounded cone. A ray enters the part at the first point
    where it meets one of the two spheres or the lateral surface.
    """
    to_part = (part.frame / part.stretch).T
    eye = to_part @ (camera.centre - part.origin)
    columns = to_part @ camera.rotation.T
    x, y, z = (u[None, :] * row[0] + (v[:, None] * row[1] + row[2]) for row in columns)
    square = x * x + y * y + z * z
    first, second = part.radii
    across = eye[0] * x + eye[1] * y + eye[2] * z
    t = _enter_sphere(square, across, float(eye @ eye) - first * first)
    if part.length == 0:
        return t
    length, taper = part.length, first - second
    beyond = eye - [0, 0, length]
    t = np.minimum(t, _enter_sphere(square, across - length * z, float(beyond @ beyond) - second * second))
    span = length * length - taper * taper
    if span <= 0:
        return t
    axial, drift = length * eye[2], length * z
    c2 = span * square - drift * drift
    c1 = span * across + drift * (taper * first - axial)
    c0 = span * float(eye @ eye) - axial * axial + 2 * axial * taper * first - (length * first) ** 2
    root = c1 * c1 - c0 * c2
    with np.errstate(divide="ignore", invalid="ignore"):
        lateral = (-np.sqrt(root) - c1) / c2
        height = axial - first * taper + lateral * drift
    valid = (root > 0) & (height > 0) & (height < span)
    return np.where(valid & (lateral < t), lateral, t)


def _enter_sphere(square: Array, across: Array, excess: float) -> Array:
    """Return the smaller root t of ``square * t^2 + 2 * across * t + excess = 0``, or infinity if there is no real
    root."""
    root = across * across - square * excess
    return np.where(root > 0, (-across - np.sqrt(np.maximum(root, 0))) / square, np.inf)


def _shade(part: Part, eye: Array, direction: Array, t: Array, gloss: float) -> Array:
    """Return the RGB colours (N, 3) of the part at the points ``eye + t * direction``, where the rays enter the
    part."""
    local = (eye - part.origin + direction * t[:, None]) @ part.frame
    normal = _normals(part, local / part.stretch) / part.stretch @ part.frame.T
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    key = np.maximum(normal @ KEY_LIGHT, 0)
    fill = np.maximum(normal @ FILL_LIGHT, 0)
    light = 0.46 + 0.1 * normal[:, 2] + 0.46 * key + 0.16 * fill
    half = KEY_LIGHT - direction / np.linalg.norm(direction, axis=1, keepdims=True)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    highlight = gloss * np.maximum((normal * half).sum(1), 0) ** SHININESS * (key > 0)
    colours = part.pattern.colours(local) * light[:, None]
    return np.clip(colours + highlight[:, None], 0, 1)


def _normals(part: Part, local: Array) -> Array:
    """Return the outward normals (N, 3) of the unscaled part at its surface points ``local`` (N, 3). The normals are
    not normalised.

    Before scaling, the part is the union of spheres whose centres lie on the segment between the centres of its two end
    spheres. The radii of the spheres in this union change linearly from one end to the other. One of these spheres
    touches the surface at the surface point. The normal is the vector from the centre of this sphere to the surface
    point.
    """
    normal = local.copy()
    if part.length > 0:
        sine = (part.radii[0] - part.radii[1]) / part.length
        tangent = sine / np.sqrt(max(1 - sine * sine, 1e-9))
        normal[:, 2] -= np.clip(local[:, 2] - np.hypot(local[:, 0], local[:, 1]) * tangent, 0, part.length)
    return normal


def _bounding_box(part: Part, camera: Camera) -> Box:
    """Return the pixel bounds (left, top, right, bottom) of the part's projection, clipped to the image.

    ``right`` and ``bottom`` are exclusive. The bounds of a part behind the camera are empty, and the bounds of a part
    that extends to both sides of the camera's plane are the whole image. For all other parts, the bounds are computed
    from the exact projections of two spheres whose convex hull contains the part.
    """
    k = camera.intrinsics
    nearest, farthest = _depth_range(part, camera)
    if farthest <= 0:
        return 0, 0, 0, 0
    if nearest <= 0:
        return 0, 0, camera.width, camera.height
    edges: list[list[float]] = [[], []]
    for centre, radius in part.spheres():
        position = camera.rotation @ centre + camera.translation
        for axis in (0, 1):
            angle = np.arctan2(position[axis], position[2])
            half_angle = np.arcsin(min(radius / np.hypot(position[axis], position[2]), 1.0))
            edges[axis] += [k[axis, axis] * np.tan(angle + sign * half_angle) + k[axis, 2] for sign in (-1, 1)]
    left, right = np.clip([np.floor(min(edges[0])), np.ceil(max(edges[0]))], 0, camera.width).astype(int)
    top, bottom = np.clip([np.floor(min(edges[1])), np.ceil(max(edges[1]))], 0, camera.height).astype(int)
    return int(left), int(top), int(right), int(bottom)


def _depth_range(part: Part, camera: Camera) -> tuple[float, float]:
    """Return the minimum and the maximum camera depth, in metres, of two spheres whose convex hull contains the
    part."""
    spheres = [(camera.rotation[2] @ centre + camera.translation[2], radius) for centre, radius in part.spheres()]
    return float(min(z - radius for z, radius in spheres)), float(max(z + radius for z, radius in spheres))


def projected_extent(parts: Sequence[Part], camera: Camera) -> Array:
    """Return the bounds (2, 2) of the parts' projection in units of the focal length.

    Row 0 contains the minimum and maximum of x, and row 1 contains the minimum and maximum of y.
    """
    spans = []
    for part in parts:
        for centre, radius in part.spheres():
            position = camera.rotation @ centre + camera.translation
            angles = np.arctan2(position[:2], position[2])
            half_angles = np.arcsin(np.minimum(radius / np.hypot(position[:2], position[2]), 1.0))
            spans.append(np.tan(np.stack([angles - half_angles, angles + half_angles], axis=1)))
    return np.stack([np.min(spans, axis=0)[:, 0], np.max(spans, axis=0)[:, 1]], axis=1)


def pixel_rays(camera: Camera, x: Array, y: Array) -> tuple[Array, Array]:
    """Return arrays u and v such that (u[i], v[j], 1) is the ray, in camera coordinates, through the image position
    (x[i], y[j]) in pixels.

    The parameter along a ray (u, v, 1) is equal to the camera depth.
    """
    k = camera.intrinsics
    return (x - k[0, 2]) / k[0, 0], (y - k[1, 2]) / k[1, 1]


def average_samples(samples: Array) -> Array:
    """Average the S x S rays of each pixel. The shape of the array changes from (h * S, w * S, ...) to (h, w, ...)."""
    height, width = samples.shape[0] // SAMPLES, samples.shape[1] // SAMPLES
    tiles: Array = samples.reshape(height, SAMPLES, width, SAMPLES, *samples.shape[2:])
    return np.asarray(tiles.mean(axis=(1, 3)), dtype=np.float64)


def as_uint8(values: Array) -> NDArray[np.uint8]:
    """Convert values in [0, 1] to 8 bits. Values outside this range are clipped."""
    return np.asarray(np.round(255 * np.clip(values, 0, 1)), dtype=np.uint8)


def as_millimetres(depth: Array) -> NDArray[np.uint16]:
    """Convert depths from metres to millimetres in 16 bits. Depths above 65.535 m are clipped."""
    return np.asarray(np.clip(np.round(1000 * depth), 0, np.iinfo(np.uint16).max), dtype=np.uint16)
