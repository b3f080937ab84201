"""Reads files of the format 4dgs, whose splats move and fade, as scenes with frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.rendering.ops.shade.harmonics import SH_CONSTANT
from fourd.scene.scene import BakedFrame
from fourd.scene.splats.cloud import TERMS_BY_DEGREE, SplatCloud, make_valid_cloud, merge_clouds
from fourd.scene.splats.dgs_writer import RATE_ATTRIBUTE, require_fourdgs
from fourd.scene.splats.frames import frame_from_splats
from fourd.scene.splats.splat_manifest import splat_manifest

SUFFIX = ".4dgs"
DEFAULT_RATE = 30.0
MAX_RATE = 1000.0
MAX_FRAMES = 1 << 20
MAX_SPLATS = 1 << 25
"""Maximum number of splats that are decoded for one frame."""
_AXES = np.concatenate([np.eye(3), -np.eye(3)])
"""Directions of the axis codes of a coordinate frame: +x, +y, +z, -x, -y, -z."""


class DgsReader:
    """Reads a file as a scene without source views. Frames are not cached: each request decodes the chunks of the file
    whose time contains the frame's time. Several threads may call the same reader.

    Frame k shows the time (k + 0.5) / fps, so that files whose splats are shown for one frame each are read frame by
    frame. The frame rate is the one in the header, or else follows from the windows in which splats are shown if all
    windows but those of the whole scene have the same length, or else is :data:`DEFAULT_RATE`. Velocities, fades, and
    the movements of objects are applied. The interface is that of :class:`fourd.scene.container.SceneReader`.

    Raises:
        UserError: if the file is damaged, has no chunk index, or contains no splats, or if the package fourdgs is not
            installed.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        require_fourdgs(self.path)
        from fourdgs.indexed_reader import open_indexed, read_objects, read_provenance
        from fourdgs.readable import FileReadable

        try:
            self._source = FileReadable(self.path)
        except OSError as error:
            raise UserError(f"{self.path}: expected a readable file, got '{error.strerror}'; check the path") from error
        self._lock = Lock()
        try:
            with self._errors():
                self._scene = open_indexed(self._source)
                self._objects = read_objects(self._source, self._scene)
                provenance = read_provenance(self._source, self._scene)
            self.rate, self.is_rate_known = self._frame_rate()
            frames = self._frame_count()
            counts = [self._splats_at(index) for index in range(frames)]
            first = next((index for index in range(frames) if counts[index] and len(self.cloud(index))), None)
            if first is None:
                raise UserError(
                    f"{self.path}: expected at least one splat with finite values, got none; write it again"
                )
            frame = provenance.frame
            up = _AXES[1 if frame is None else frame.up_axis]
            manifest = splat_manifest(self.cloud(first), up, range(frames), counts, "4dgs file")
            metres = None if frame is None else provenance.metres_per_unit(frame.name)
            self.manifest = replace(
                manifest, fps=self.rate, is_fps_known=self.is_rate_known, metres_per_unit=metres or None
            )
        except BaseException:
            self._source.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    def read(self, index: int) -> BakedFrame:
        """Read the frame with the 0-based ``index``.

        Raises IndexError if there is no such frame, and UserError if the file is damaged.
        """
        if not 0 <= index < self.manifest.frame_count:
            raise IndexError(f"frame: expected 0 to {self.manifest.frame_count - 1}, got {index}")
        return frame_from_splats(self.cloud(index))

    def read_dynamic(self, index: int) -> BakedFrame:
        """Read frame ``index``. There is no separate background."""
        return self.read(index)

    def read_background(self) -> None:
        """Return None, because the file does not separate static splats."""

    def read_shadow(self, index: int) -> None:
        """Return None, because splats have no shadows."""

    def read_sound(self) -> None:
        """Return None, because the sound of such files is not read."""

    def cloud(self, index: int) -> SplatCloud:
        """Return the splats of the frame with the 0-based ``index``. Raises UserError if the file is damaged."""
        from fourdgs.indexed_reader import read_chunk
        from fourdgs.object_layer import state_at_with_objects

        time, degree = (index + 0.5) / self.rate, self._scene.header.sh_degree
        if self._splats_at(index) > MAX_SPLATS:
            raise self._damaged(f"more than {MAX_SPLATS:,} splats at once")
        clouds = [_empty(degree)]
        with self._lock, self._errors():
            for entry in self._scene.chunks_for_time(time):
                chunk = read_chunk(self._source, self._scene, entry, max_sh_band=degree)
                splats = _splats(chunk, self._scene.windows)
                state = state_at_with_objects(splats, self._objects, time, self._scene.header.cutoff)
                clouds.append(_cloud(splats, state, chunk["sh"], degree))
        return merge_clouds(clouds)

    def _splats_at(self, index: int) -> int:
        """Return the number of splats in the chunks of a frame, of which some may be invisible."""
        return sum(entry.gaussian_count for entry in self._scene.chunks_for_time((index + 0.5) / self.rate))

    def _frame_count(self) -> int:
        seconds, splats = self._scene.header.duration_sec, self._scene.header.gaussian_count
        if not self._scene.index and splats:
            raise self._damaged("no index of its chunks")
        if not math.isfinite(seconds) or not 0 <= seconds * self.rate <= MAX_FRAMES:
            raise self._damaged(f"a duration of {seconds:g} s")
        return max(round(seconds * self.rate), 1)

    def _frame_rate(self) -> tuple[float, bool]:
        """Return the frame rate, and whether the file states it."""
        try:
            stated = float(self._scene.header.attributes.get(RATE_ATTRIBUTE, "nan"))
        except ValueError:
            stated = math.nan
        if 0 < stated <= MAX_RATE:
            return stated, True
        seconds = self._scene.header.duration_sec
        lengths = [end - start for start, end in self._scene.windows if 0 < end - start < 0.99 * seconds]
        if lengths and max(lengths) < 1.01 * min(lengths) and 1 / MAX_RATE <= min(lengths) <= 1:
            return len(lengths) / math.fsum(lengths), True
        return DEFAULT_RATE, False

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Convert the errors of the package to UserError."""
        from fourdgs import FourdgsError

        try:
            yield
        except (FourdgsError, ValueError, OverflowError, IndexError, KeyError, TypeError, MemoryError) as error:
            raise self._damaged(str(error).splitlines()[0] if str(error) else type(error).__name__) from error
        except OSError as error:
            raise UserError(f"{self.path}: expected a readable file, got '{error.strerror}'; copy it again") from error

    def _damaged(self, found: str) -> UserError:
        return UserError(f"{self.path}: expected a valid file of the format 4dgs, got: {found}; write the file again")


def _splats(chunk: dict[str, Any], windows: list[tuple[float, float]]) -> Any:
    """Return the splats of a decoded chunk as the package's GaussianSet."""
    from fourdgs import GaussianSet
    from fourdgs.stream_reader import window_table_or_default

    table = window_table_or_default(windows)
    window = table[chunk["window_index"]]
    names = ("positions", "scales", "rotations", "colors", "motions", "mu_t", "sigma_t", "object_id")
    return GaussianSet(**{name: chunk[name] for name in names}, win_lo=window[:, 0], win_hi=window[:, 1])


def _cloud(splats: Any, state: dict[str, Any], bands: dict[int, NDArray[np.int64]], degree: int) -> SplatCloud:
    """Return those splats that are visible at a time."""
    from fourdgs.quantization import sh_coefficient

    shown = state["indices"]
    sh = np.zeros((len(shown), 3, TERMS_BY_DEGREE[degree]), np.float32)
    sh[..., 0] = (splats.colors[shown, :3] - 0.5) / SH_CONSTANT
    for band, codes in bands.items():
        first, last = band**2, (band + 1) ** 2
        sh[..., first:last] = sh_coefficient(codes[shown]).reshape(len(shown), 3, last - first)
    with np.errstate(over="ignore", invalid="ignore"):  # Values that are not finite are left out.
        return make_valid_cloud(
            state["centers"].astype(np.float32),
            splats.scales[shown].astype(np.float32),
            state["orientations"][:, [3, 0, 1, 2]].astype(np.float32),
            state["opacity"].astype(np.float32),
            sh,
        )


def _empty(degree: int) -> SplatCloud:
    sh = np.zeros((0, 3, TERMS_BY_DEGREE[degree]), np.float32)
    vectors, quaternions = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32)
    return SplatCloud(vectors, vectors, quaternions, np.zeros(0, np.float32), sh)
