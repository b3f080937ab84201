"""Images of a frame for compositing: opacity, depth and normals."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.pixel_filter.reference import filter_pixels_reference
from fourd.rendering.ops.play.near_fade import fade_near
from fourd.rendering.ops.points.arrays import render_points_numpy
from fourd.scene.meshes.drawing import GeometryBuffer
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.styled.normals import FrameNormals
from fourd.scene.styles.normals import decode_octahedral

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Channels:
    """Images of a frame, float32. The pixel filter of a scene is applied to alpha, as to its colours.

    Attributes:
        alpha: (H, W) opacity in [0, 1].
        depth: (H, W) camera depth z in world units, 0 where nothing covers the pixel.
        normal: (H, W, 3) unit normals in camera axes with x right, y up and z towards the camera; 0 where nothing
            covers the pixel.
    """

    alpha: Floats
    depth: Floats
    normal: Floats


@dataclass(frozen=True)
class ChannelPainter:
    """Computes the channels of frames of points, and keeps the normals that it estimates for scenes without normals."""

    _normals: FrameNormals = field(default_factory=FrameNormals)

    def draw(self, frame: BakedFrame, camera: Camera, manifest: SceneManifest, layers: int | None = None) -> Channels:
        """Composite the K = ``layers`` nearest points of each pixel, or as many as the scene has layers if ``layers``
        is None. Normals are composited like colours, and then normalized."""
        normals = decode_octahedral(self._normals.get(frame, manifest)) @ camera.rotation.T.astype(np.float32)
        summed, alpha, depth = render_points_numpy(
            frame.xyz,
            np.ascontiguousarray(normals, np.float32),
            frame.radius.astype(np.float32),
            fade_near(frame.xyz, frame.density, camera, manifest.near),
            camera,
            layers=layers or manifest.layers,
            near=manifest.near,
        )
        return Channels(filter_pixels_reference(alpha, manifest.pixel_filter), depth, _upright(summed))


def mesh_channels(buffer: GeometryBuffer) -> Channels:
    """Return the channels of a mesh that has been drawn."""
    depth = buffer.depth / np.maximum(buffer.hits, 1)
    return Channels(buffer.alpha, depth.astype(np.float32), _upright(buffer.normal))


def _upright(normal: Floats) -> Floats:
    """Return unit normals (H, W, 3) from sums of normals in OpenCV's camera axes, with y up and z backwards."""
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    unit = np.divide(normal, length, out=np.zeros_like(normal), where=length > 1e-6)
    return (unit * np.array([1, -1, -1], np.float32)).astype(np.float32)
