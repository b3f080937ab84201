"""Drawing of triangle meshes as images, and as the visible surface (depths and normals), from which drawing styles
(:mod:`fourd.scene.styles`) compute shading and lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.formats.mesh import WHITE, Mesh
from fourd.rendering.ops.meshes.arrays import draw_attributes
from fourd.rendering.ops.stylize.parameters import Surface

SAMPLES = 3
"""Samples per pixel along each axis."""
_MAP_COLUMNS = 1024
_NEAR_SHARE = 1e-4
"""Minimum depth of the near plane, as a fraction of the far plane's depth."""


@dataclass(frozen=True, eq=False)
class GeometryBuffer:
    """Sums of colours, depths and normals over the samples of each pixel. Samples without a triangle contribute 0.

    Attributes:
        rgb: (H, W, 3) float32, sums of colours in [0, 1].
        depth: (H, W) float32, sums of camera depths in world units.
        normal: (H, W, 3) float32, sums of unit normals in the camera's frame. Each of these normals
            points towards the camera, even if the camera sees the back of the triangle.
        hits: (H, W) float32 number of samples with a triangle.
        samples: number of samples per pixel.
    """

    rgb: NDArray[np.float32]
    depth: NDArray[np.float32]
    normal: NDArray[np.float32]
    hits: NDArray[np.float32]
    samples: int

    @property
    def alpha(self) -> NDArray[np.float32]:
        """(H, W) float32 fraction of each pixel that the mesh covers, in [0, 1]."""
        return self.hits / np.float32(self.samples)

    def picture(self, background: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the image (H, W, 3) float32 in [0, 1] of the mesh in front of a background colour (3,)."""
        return self.rgb / np.float32(self.samples) + (1 - self.alpha)[..., None] * background

    def surface(self) -> Surface:
        """Return the buffer in the form that the stylizer needs."""
        alpha, hits = self.alpha, np.maximum(self.hits, 1)
        coverage = np.clip(3 * alpha - 0.5, 0, 1)
        depth = self.depth / hits
        inverse = np.divide(coverage, depth, out=np.zeros_like(depth), where=depth > 0)
        albedo = np.concatenate([self.rgb / np.float32(self.samples), alpha[..., None]], 2)
        length = np.linalg.norm(self.normal, axis=2, keepdims=True)
        unit = np.where(coverage[..., None] > 0, self.normal / np.maximum(length, 1e-12), 0)
        normal = np.concatenate([np.rint(127 * unit) + 128, np.rint(255 * coverage)[..., None]], 2)
        return Surface(np.rint(255 * albedo).astype(np.uint8), inverse.astype(np.float32), normal.astype(np.uint8))


def draw_mesh(mesh: Mesh, camera: Camera, *, samples: int = SAMPLES, threads: int = 0) -> GeometryBuffer:
    """Draw a mesh without lighting. Both sides of triangles are visible.

    Args:
        camera: pinhole camera.
        samples: samples per pixel along each axis, at least 1.
        threads: see :func:`fourd.rendering.ops.meshes.arrays.draw_attributes`.
    """
    size = (camera.height, camera.width)
    rgb, normal = np.zeros((*size, 3), np.float32), np.zeros((*size, 3), np.float32)
    depth, hits = np.zeros(size, np.float32), np.zeros(size, np.float32)
    attributes = _attributes(mesh, camera)
    left, top, width, height = _box(mesh.xyz, camera)
    part = np.s_[top : top + height, left : left + width]
    for moved in _sample_cameras(camera.crop(left, top, width, height), samples):
        values, seen = draw_attributes(_clip(mesh.xyz, moved), mesh.triangles, attributes, (height, width), threads)
        found = values[seen]
        rgb[part][seen] += _colours(mesh, found[:, 4:])
        depth[part][seen] += found[:, 0]
        normal[part][seen] += _towards_camera(found[:, 1:4], moved, seen)
        hits[part] += seen
    return GeometryBuffer(rgb, depth, normal, hits, samples * samples)


def _box(xyz: NDArray[np.float32], camera: Camera) -> tuple[int, int, int, int]:
    """Return left, top, width and height, in pixels, of an image region that contains the mesh. The region has at least
    one pixel, and is the whole image if the mesh extends behind the camera."""
    pixels, depth = camera.project(xyz)
    if depth.min() <= 0:
        return 0, 0, camera.width, camera.height
    size = (camera.width, camera.height)
    lower = np.clip(np.floor(pixels.min(0)) - 1, 0, np.subtract(size, 1)).astype(int)
    upper = np.clip(np.ceil(pixels.max(0)) + 1, lower + 1, size).astype(int)
    return int(lower[0]), int(lower[1]), int(upper[0] - lower[0]), int(upper[1] - lower[1])


def _attributes(mesh: Mesh, camera: Camera) -> NDArray[np.float32]:
    """Return each vertex's depth, its normal in the camera's frame, and its texture coordinates or colour, (V, 6 or
    7)."""
    assert mesh.normals is not None
    depth = mesh.xyz @ camera.rotation[2] + camera.translation[2]
    if mesh.uv is not None:
        last = mesh.uv
    else:
        grey = np.full((len(mesh.xyz), 3), WHITE, np.uint8)
        last = (grey if mesh.rgb is None else mesh.rgb).astype(np.float32) / np.float32(255)
    return np.concatenate([depth[:, None], mesh.normals @ camera.rotation.T, last], 1).astype(np.float32)


def _sample_cameras(camera: Camera, samples: int) -> Iterator[Camera]:
    """Yield one camera per sample position within a pixel. Its principal point is shifted such that its pixel centres
    lie at the sample position."""
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    for down in offsets:
        for right in offsets:
            intrinsics = camera.intrinsics.copy()
            intrinsics[:2, 2] -= (right, down)
            yield replace(camera, intrinsics=intrinsics)


def _clip(xyz: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Return clip coordinates (V, 4). The far plane lies behind all vertices. The near plane has half the depth of the
    nearest vertex in front of the camera, but at least ``_NEAR_SHARE`` times the depth of the far plane. Because of
    this minimum, vertices very close to the camera can be clipped."""
    points = xyz.astype(np.float64) @ camera.rotation.T + camera.translation
    depth = points[:, 2]
    in_front = depth[depth > 0]
    far = 2 * float(in_front.max(initial=1e-6))
    near = max(0.5 * float(in_front.min(initial=far)), _NEAR_SHARE * far)
    pixels = points @ camera.intrinsics.T
    x, y = (2 * pixels[:, axis] / side - depth for axis, side in ((0, camera.width), (1, camera.height)))
    z = ((far + near) * depth - 2 * far * near) / (far - near)
    return np.stack([x, y, z, depth], 1).astype(np.float32)


def _towards_camera(normal: NDArray[np.float32], camera: Camera, seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the unit normals (P, 3) of the pixels ``seen``, reversed where the camera sees the back of a triangle."""
    row, column = np.nonzero(seen)
    inverse = np.linalg.inv(camera.intrinsics).astype(np.float32)
    position = np.stack([column + np.float32(0.5), row + np.float32(0.5), np.ones(len(row), np.float32)], 1)
    along = (normal * (position @ inverse.T)).sum(1)
    scale = np.where(along > 0, np.float32(-1), np.float32(1)) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    return np.asarray(normal * scale[:, None], np.float32)


def _colours(mesh: Mesh, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return colours (P, 3) in [0, 1]. ``values`` are texture coordinates (P, 2) if the mesh has a texture, or else the
    interpolated colours (P, 3)."""
    if mesh.texture is None:
        return values
    height, width = mesh.texture.shape[:2]
    # The list of positions is arranged in rows, because cv2.remap needs coordinate arrays with sides below 32768.
    padded = np.zeros((2, max(-(-len(values) // _MAP_COLUMNS), 1), _MAP_COLUMNS), np.float32)
    padded.reshape(2, -1)[:, : len(values)] = values.T * np.array([[width], [height]], np.float32) - np.float32(0.5)
    colours = cv2.remap(mesh.texture, padded[0], padded[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(colours.reshape(-1, 3)[: len(values)].astype(np.float32) / np.float32(255))
