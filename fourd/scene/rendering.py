"""Opening of baked scenes, and rendering of their frames with NumPy and native kernels, without torch."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from threading import Lock
from types import TracebackType

import numpy as np
from cachetools import LRUCache
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.storage import Location, parse_location
from fourd.rendering.ops.pixel_filter.reference import filter_pixels_reference
from fourd.rendering.ops.play.near_fade import fade_near
from fourd.rendering.ops.points.arrays import render_points_numpy
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.shade import shade
from fourd.scene.splats.reader import open_reader

CACHE_BYTES = 256 << 20
_PICTURE_SIDE = 640
"""Longest side, in pixels, of the picture of a scene in a notebook."""


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """An image: rgb (H, W, 3) in [0, 1], alpha (H, W) and camera depth (H, W) in world units, all float32.

    The scene's pixel filter, which smooths jagged contours, is applied to ``rgb`` and ``alpha``, but not to ``depth``.
    """

    rgb: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]

    def to_uint8(self) -> NDArray[np.uint8]:
        """Return ``rgb`` as (H, W, 3) uint8. Values are multiplied by 255 and rounded to the nearest integer."""
        return np.round(self.rgb * 255).astype(np.uint8)


class Scene:
    """An open baked scene. Several threads may use one instance at the same time.

    Use the scene as a context manager, or call :meth:`close` when it is no longer needed. The most recently used frames
    are cached, up to ``cache_bytes``.
    """

    def __init__(self, path: Location | str, *, cache_bytes: int = CACHE_BYTES) -> None:
        self._reader = open_reader(parse_location(path))
        manifest = self._reader.manifest
        largest = max((manifest.frame_nbytes(index) for index in range(manifest.frame_count)), default=0)
        # The background, which the reader keeps in memory, counts towards ``cache_bytes``. The cache is at least large
        # enough for the largest frame.
        size = max(cache_bytes - manifest.background_nbytes, largest)
        self._cache: LRUCache[int, BakedFrame] = LRUCache(size, getsizeof=lambda frame: frame.nbytes)
        self._lock = Lock()

    @property
    def path(self) -> Location:
        return self._reader.path

    @property
    def manifest(self) -> SceneManifest:
        return self._reader.manifest

    def __repr__(self) -> str:
        manifest = self.manifest
        return (
            f"<Scene {self.path}: kind {manifest.kind}, {len(self)} frames at {manifest.fps:g} per second, "
            f"{len(manifest.names)} cameras>"
        )

    def _repr_png_(self) -> bytes | None:
        """Return what notebooks show for the value of a cell: the first frame from the first camera, as a PNG file."""
        from PIL import Image

        if not self.manifest.cameras or not len(self):
            return None
        camera = self.manifest.cameras[0]
        picture = io.BytesIO()
        pixels = self.render(camera.rescale(min(1.0, _PICTURE_SIDE / max(camera.width, camera.height)))).to_uint8()
        Image.fromarray(pixels).save(picture, "PNG")
        return picture.getvalue()

    def __iter__(self) -> Iterator[BakedFrame]:
        """Yield the frames in order. Frames that are no longer cached are read again."""
        return (self.frame(index) for index in range(len(self)))

    def __len__(self) -> int:
        return self.manifest.frame_count

    def __enter__(self) -> Scene:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and release the cached frames."""
        self._reader.close()
        with self._lock:
            self._cache.clear()

    def frame(self, index: int) -> BakedFrame:
        """Return the frame with the 0-based ``index``: the dynamic points, then the background points, in read-only
        arrays.

        Raises IndexError if the scene has no such frame, and UserError if the file is damaged.
        """
        with self._lock:
            cached = self._cache.get(index)
        if cached is not None:
            return cached
        frame = self._reader.read(index)
        with self._lock:
            self._cache[index] = frame
        return frame

    def dynamic_frame(self, index: int) -> BakedFrame:
        """Return the points of a frame without those of the background. They are read at each call.

        Raises IndexError if the scene has no such frame, and UserError if the file is damaged.
        """
        return self._reader.read_dynamic(index)

    def background(self) -> BakedFrame | None:
        """Return the static points, without shadows, or None if the scene has none. Raises UserError."""
        return self._reader.read_background()

    def render(
        self,
        camera: Camera | str,
        frame: int = 0,
        *,
        layers: int | None = None,
        background: NDArray[np.float32] | None = None,
        threads: int = 0,
    ) -> RenderedImage:
        """Render a frame.

        Args:
            camera: a pinhole camera without lens distortion, or the name of a camera of the capture, such as "03".
            frame: 0-based index of the frame.
            layers: maximum number of points that are composited per pixel. If ``layers`` is None, the manifest's value
                is used.
            background: (3,) RGB colour in [0, 1] behind the points, or None for black.
            threads: number of threads. 0 means the environment variable FOURD_THREADS, or all cores if it is not set.

        Raises:
            IndexError: if the scene has no such frame. UserError: if the file is damaged.
            TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
        """
        view = self.camera(camera) if isinstance(camera, str) else camera
        return render_frame(
            self.frame(frame), view, self.manifest, layers=layers, background=background, threads=threads
        )

    def camera(self, name: str) -> Camera:
        """Return the camera of the capture with this name. Raises ValueError, with the names, if there is none."""
        names = self.manifest.names
        if name not in names:
            raise ValueError(f"camera: expected one of the names {', '.join(names)}, got '{name}'")
        return self.manifest.camera(name)


def render_frame(
    frame: BakedFrame,
    camera: Camera,
    manifest: SceneManifest,
    *,
    layers: int | None = None,
    background: NDArray[np.float32] | None = None,
    threads: int = 0,
) -> RenderedImage:
    """Render a frame of the scene that ``manifest`` describes. The other arguments are those of
    :meth:`Scene.render`."""
    rgb, alpha, depth = render_points_numpy(
        frame.xyz,
        shade(frame, camera, manifest, threads=threads),
        frame.radius.astype(np.float32),
        fade_near(frame.xyz, frame.density, camera, manifest.near),
        camera,
        layers=layers or manifest.layers,
        near=manifest.near,
        background=background,
        threads=threads,
    )
    rgb, alpha = (filter_pixels_reference(image, manifest.pixel_filter) for image in (np.clip(rgb, 0, 1), alpha))
    return RenderedImage(rgb, alpha, depth)


def open_scene(path: Location | str, *, cache_bytes: int = CACHE_BYTES) -> Scene:
    """Open a `.4dv`, a `.ply` or `.splat` file of Gaussian splats, or a folder with one such file for each frame.

    Args:
        path: a path, or the URL of a `.4dv`, such as s3://bucket/scene.4dv. A scene at a URL is read with range
            requests.
        cache_bytes: size in bytes of the cache for frames and the background. One frame is cached even if it exceeds
            this limit.

    Raises:
        UserError: if the file is not a valid scene. The message is one line that names the file and says how to solve
            the problem.
    """
    return Scene(path, cache_bytes=cache_bytes)
