"""Opening a baked scene and rendering its frames: NumPy and the native kernels, no torch."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from fourd.baking.container import SceneReader
from fourd.baking.scene import BakedFrame, SceneManifest
from fourd.baking.shade import shade
from fourd.cameras import Camera
from fourd.ops.points.arrays import render_points_numpy

CACHE_BYTES = 256 << 20


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """A picture: rgb (H, W, 3) in [0, 1], alpha (H, W) and camera depth (H, W) in world units, float32."""

    rgb: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]

    def to_uint8(self) -> NDArray[np.uint8]:
        """rgb as (H, W, 3) bytes, rounded."""
        return np.round(self.rgb * 255).astype(np.uint8)


class Scene:
    """A baked scene that was opened. Threads may share it.

    Use as a context manager or call :meth:`close`. A few frames are kept in memory, by size.
    """

    def __init__(self, path: Path | str, *, cache_bytes: int = CACHE_BYTES) -> None:
        self._reader = SceneReader(path)
        self._cache: OrderedDict[int, BakedFrame] = OrderedDict()
        self._cache_bytes = cache_bytes - self._reader.manifest.background_nbytes  # which the reader keeps
        self._lock = Lock()

    @property
    def path(self) -> Path:
        return self._reader.path

    @property
    def manifest(self) -> SceneManifest:
        return self._reader.manifest

    def __len__(self) -> int:
        return self.manifest.frame_count

    def __enter__(self) -> Scene:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and let go of the frames."""
        self._reader.close()
        self._cache.clear()

    def frame(self, index: int) -> BakedFrame:
        """The arrays of frame ``index`` from 0, a background's points behind its own; read-only.

        Raises IndexError outside the scene, UserError when the file is damaged there.
        """
        with self._lock:
            if index in self._cache:
                self._cache.move_to_end(index)
                return self._cache[index]
        frame = self._reader.read(index)
        with self._lock:
            self._cache[index] = frame
            while len(self._cache) > 1 and sum(item.nbytes for item in self._cache.values()) > self._cache_bytes:
                self._cache.popitem(last=False)
        return frame

    def render(
        self,
        camera: Camera,
        frame: int,
        *,
        layers: int | None = None,
        background: NDArray[np.float32] | None = None,
        threads: int = 0,
    ) -> RenderedImage:
        """Render frame ``frame`` (index from 0) from a pinhole ``camera``.

        Args:
            layers: points composited in a pixel; None for the manifest's.
            background: (3,) colour in [0, 1] behind the points; None for black.
            threads: 0 for FOURD_THREADS if that is set, else one a core.
        """
        baked = self.frame(frame)
        rgb, alpha, depth = render_points_numpy(
            baked.xyz,
            shade(baked, camera, self.manifest, threads=threads),
            baked.radius.astype(np.float32),
            baked.density.astype(np.float32),
            camera,
            layers=layers or self.manifest.layers,
            near=self.manifest.near,
            background=background,
            threads=threads,
        )
        return RenderedImage(np.clip(rgb, 0, 1), alpha, depth)


def open_scene(path: Path | str, *, cache_bytes: int = CACHE_BYTES) -> Scene:
    """Open a `.4dv`.

    Args:
        cache_bytes: memory for frames that were read and a background; one frame is kept whatever its size.

    Raises:
        UserError: one line that names the file and the mend, when it is no whole scene.
    """
    return Scene(path, cache_bytes=cache_bytes)
