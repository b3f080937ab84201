"""Normals of baked frames: stored in the scene, or estimated from the positions and the blend weights."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
from cachetools import LRUCache
from numpy.typing import NDArray

from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.styles.normals import Visibility, encode_octahedral, estimate_normals

CACHE_BYTES = 64 << 20
_SAMPLES = 4096


def add_normals(frame: BakedFrame, manifest: SceneManifest, *, is_background: bool = False) -> BakedFrame:
    """Return ``frame`` with estimated normals. The normal of a point is directed out of the surface, towards those
    source cameras of ``manifest`` that see the point.

    Args:
        is_background: whether the points surround the cameras. If true, the normals of points that no source camera
            sees are also directed towards the source cameras.
    """
    return replace(frame, normals=_estimate(frame.xyz, frame.blend_weights, manifest, is_background))


def _estimate(
    xyz: NDArray[np.float32], blend_weights: NDArray[np.float16], manifest: SceneManifest, is_background: bool
) -> NDArray[np.uint8]:
    centres = np.array([camera.centre for camera in manifest.source_cameras]).reshape(-1, 3)
    weights = blend_weights
    if is_background:
        weights = np.where((weights > 0).any(1, keepdims=True), weights, np.float16(1))
    return encode_octahedral(estimate_normals(xyz, Visibility(weights, centres)))


class FrameNormals:
    """Returns the normals of frames, and keeps estimated normals in a cache of CACHE_BYTES.

    An estimate takes about 0.5 s for 40,000 points. The normals of dynamic points and of the background are estimated
    separately, so that those of the background are estimated only once.
    """

    def __init__(self) -> None:
        self._cache: LRUCache[bytes, NDArray[np.uint8]] = LRUCache(
            CACHE_BYTES, getsizeof=lambda normals: normals.nbytes
        )

    def get(self, frame: BakedFrame, manifest: SceneManifest) -> NDArray[np.uint8]:
        """Return the (N, 2) uint8 octahedral normals of a frame."""
        if frame.normals is not None:
            return frame.normals
        count = frame.dynamic_count
        if count == frame.point_count:
            return self._estimate(frame, slice(None), manifest, is_background=False)
        own = self._estimate(frame, slice(0, count), manifest, is_background=False)
        return np.concatenate([own, self._estimate(frame, slice(count, None), manifest, is_background=True)])

    def _estimate(
        self, frame: BakedFrame, part: slice, manifest: SceneManifest, *, is_background: bool
    ) -> NDArray[np.uint8]:
        xyz = frame.xyz[part]
        # The cache key is a hash of the positions, because a frame that is read again has equal positions in a new
        # array.
        samples = xyz[:: max(1, len(xyz) // _SAMPLES)].tobytes()
        key = hashlib.sha256(samples + str((xyz.shape, is_background)).encode()).digest()
        if key not in self._cache:
            normals = _estimate(xyz, frame.blend_weights[part], manifest, is_background)
            if normals.nbytes > self._cache.maxsize:
                return normals
            self._cache[key] = normals
        return self._cache[key]
