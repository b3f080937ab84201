"""Images of the frames of a 4D scene through a lens: :func:`draw_through_lens`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.pixel_filter.reference import filter_pixels_reference
from fourd.rendering.ops.play.near_fade import fade_near
from fourd.rendering.ops.rays.discs import DiscTree
from fourd.scene.lenses.inserts import Insert
from fourd.scene.lenses.lens import Lens
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.shade import shade

Array = NDArray[np.float64]

MAX_BOUNCES = 3
"""Maximum number of inserts (mirrors or glass balls) that a ray meets on its way. If it meets one more, the background
is drawn in place of that insert."""
RAYS_PER_CHUNK = 1 << 18
"""Number of rays that are traced at once, limited to save memory."""
MIN_SHARE = 1 / 512
"""A ray that continues from an insert is traced only if it contributes more than this fraction of the previous ray's
light."""


@dataclass(frozen=True)
class _Traced:
    """The objects that rays can hit: the points of a frame, and inserts (mirrors and glass balls)."""

    tree: DiscTree
    colours: NDArray[np.float32]
    inserts: Sequence[Insert]
    background: Array
    near: float
    layers: int
    threads: int

    def light(self, origins: Array, directions: Array, facing: Array | None, bounces: int) -> Array:
        """Return the RGB colours (R, 3) that arrive along the rays."""
        at = [insert.hits(origins, directions) for insert in self.inserts]
        nearest = np.min(at, axis=0) if at else np.full(len(origins), np.inf)
        rgba = self.tree.composite(
            self.colours,
            origins.astype(np.float32),
            directions.astype(np.float32),
            facing=None if facing is None else facing.astype(np.float32),
            t_min=self.near if facing is not None else 0.0,
            t_max=nearest.astype(np.float32),
            layers=self.layers,
            threads=self.threads,
        ).astype(np.float64)
        behind = np.broadcast_to(self.background, (len(origins), 3)).copy()
        visible = 1 - rgba[:, 3]
        for insert, t in zip(self.inserts, at, strict=True):
            rays = np.nonzero((t == nearest) & np.isfinite(t) & (visible > MIN_SHARE))[0]
            if len(rays) > 0 and bounces < MAX_BOUNCES:
                points = origins[rays] + t[rays, None] * directions[rays]
                behind[rays] = self._through(insert, points, directions[rays], bounces)
        return rgba[:, :3] + visible[:, None] * behind

    def _through(self, insert: Insert, points: Array, directions: Array, bounces: int) -> Array:
        branches, light = insert.leave(points, directions)
        for branch in branches:
            kept = branch.share > MIN_SHARE
            if kept.any():
                arriving = self.light(branch.origins[kept], branch.directions[kept], None, bounces + 1)
                light[kept] += branch.share[kept, None] * arriving
        return light


def draw_through_lens(
    frame: BakedFrame,
    camera: Camera,
    manifest: SceneManifest,
    lens: Lens,
    *,
    inserts: Sequence[Insert] = (),
    layers: int | None = None,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    threads: int = 0,
) -> NDArray[np.float32]:
    """Draw a frame through a lens, as RGB (H, W, 3) float32 in [0, 1].

    Points are discs, and the alpha at a distance d from a disc's centre is density * (1 - d^2 / radius^2). For a
    :class:`~fourd.scene.lenses.lens.Pinhole` and a :class:`~fourd.scene.lenses.lens.ThinLens`, discs are parallel to
    the image plane, and points fade at the scene's near plane (:mod:`fourd.rendering.ops.play.near_fade`). With
    inserts, points are cut off there without a fade, because a mirror can show what is beside or behind the camera. For
    other lenses, each disc faces the ray, and there is no near plane. A point has the colour that it shows towards the
    camera, even if a ray reaches the point through a mirror or glass.

    Args:
        frame: a frame whose values are all finite.
        camera: a pinhole camera without lens distortion, which determines the position, the axes and the image size.
        lens: the lens. Images with one ray in each pixel are filtered by the scene's pixel filter.
        inserts: mirrors and glass balls in the scene.
        layers: maximum number K of points that are composited for each ray; None for the scene's value.
        background: RGB colour behind the points, in [0, 1].
        threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores.
    """
    rays = lens.rays(camera)
    density = frame.density.astype(np.float32)
    if rays.facing is not None and not inserts:
        density = fade_near(frame.xyz, density, camera, manifest.near)
    colours = shade(frame, camera, manifest, threads=threads)
    tree = DiscTree(frame.xyz, frame.radius.astype(np.float32), density, threads=threads)
    traced = _Traced(tree, colours, inserts, np.asarray(background), manifest.near, layers or manifest.layers, threads)
    size = rays.width * rays.height
    sums, counts = np.zeros((size, 3)), np.bincount(rays.pixels, minlength=size)
    for begin in range(0, len(rays.pixels), RAYS_PER_CHUNK):
        part = slice(begin, begin + RAYS_PER_CHUNK)
        light = traced.light(rays.origins[part], rays.directions[part], rays.facing, 0)
        for channel in range(3):
            sums[:, channel] += np.bincount(rays.pixels[part], light[:, channel], minlength=size)
    image = sums / np.maximum(counts, 1)[:, None]
    picture = image.reshape(rays.height, rays.width, 3).clip(0, 1).astype(np.float32)
    return filter_pixels_reference(picture, manifest.pixel_filter) if counts.max(initial=0) <= 1 else picture
