"""Writes Gaussian splats over time as a file in the container format 4dgs, one frame at a time.

The format has no frames: each splat has a window of time in which it is shown, a velocity, and a fade. A frame becomes
splats that stand still, do not fade, and have the frame's time as their window. Each frame is a chunk of its own, so
that players seek by reading a part of the file. The records are those of the package fourdgs, whose own function
``write`` needs all splats of a scene in memory.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.scene.splats.cloud import SMALLEST_SCALE, SplatCloud

RATE_ATTRIBUTE = "frames_per_second"
"""Attribute of the header that states the frame rate."""
PROFILE = "fine"
"""Precision of the package: colours to 0.5 / 255, and positions to 2% of the median standard deviation."""
DEFAULT_SCALE = 1e-3
"""Median standard deviation that is assumed if the first frame is empty."""
_BANDS = {1: (1, 4), 2: (4, 9), 3: (9, 16)}
"""Terms of :attr:`SplatCloud.sh` of each degree."""
_RIGHT_HANDED, _UP, _FORWARD = 1, 1, 5
"""Codes of a right-handed coordinate frame with +y up and -z forward."""


def require_fourdgs(path: Path) -> Any:
    """Import the package fourdgs. Raises UserError if the package is not installed."""
    if importlib.util.find_spec("fourdgs") is None:
        raise UserError(
            f"{path}: files of the format 4dgs need the package fourdgs, which is not installed; "
            "pip install 'fourd[splats]'"
        )
    import fourdgs

    return fourdgs


@dataclass(frozen=True)
class StartView:
    """The viewpoint from which players show a scene first: the vertical field of view in degrees, the position, and the
    point in the middle of the image, both in world units."""

    fov_y_degrees: float
    position: tuple[float, float, float]
    target: tuple[float, float, float]


@dataclass(frozen=True)
class DgsSettings:
    """What a file states besides its splats.

    Attributes:
        frames: number of frames.
        fps: frames per second.
        degree: degree of the spherical harmonics of all splats, 0 to 3.
        metres_per_unit: length of a world unit in metres, or None if it is not known.
        view: the viewpoint from which players show the scene first, or None.
        has_up_y: whether the up direction is +y, which the file then states.
    """

    frames: int
    fps: float
    degree: int
    metres_per_unit: float | None
    view: StartView | None
    has_up_y: bool

    @property
    def seconds(self) -> float:
        """Duration of the scene."""
        return self.frames / self.fps


class DgsWriter:
    """Writes the records of a file. Call :meth:`add_background` at most once, :meth:`add_frame` for each frame, and
    :meth:`finish` at the end.

    Args:
        stream: an empty binary file that can seek.
        settings: what the file states besides its splats.

    Raises:
        UserError: if the package fourdgs is not installed.
    """

    def __init__(self, stream: BinaryIO, settings: DgsSettings, path: Path) -> None:
        require_fourdgs(path)
        self._stream, self._settings = stream, settings
        self._steps: Any = None
        self._index: list[Any] = []
        self._count = 0
        self._lower, self._upper = np.full(3, np.inf), np.full(3, -np.inf)

    def add_background(self, cloud: SplatCloud) -> None:
        """Write splats that are shown all the time."""
        self._add(cloud, self._settings.frames, 0.0, self._settings.seconds)

    def add_frame(self, index: int, cloud: SplatCloud) -> None:
        """Write the splats of the frame with the 0-based ``index``."""
        rate = self._settings.fps
        self._add(cloud, index, index / rate, (index + 1) / rate)

    def finish(self) -> None:
        """Write the index of the chunks, and the header again, which states the number of splats."""
        from fourdgs import records
        from fourdgs.serialization import MAGIC, crc32

        if self._steps is None:
            self._begin(np.zeros((0, 3)))
        start = self._stream.tell()
        summary = b"".join(entry.encode() for entry in self._index)
        footer = records.Footer(summary_start=start if summary else 0, summary_crc=crc32(summary) if summary else 0)
        self._stream.write(summary + footer.encode() + MAGIC)
        self._stream.seek(len(MAGIC))
        self._stream.write(self._header())
        self._stream.seek(0, 2)

    def _add(self, cloud: SplatCloud, window: int, start: float, end: float) -> None:
        """Write a chunk with a cloud that is shown from ``start`` to ``end``, in seconds."""
        from fourdgs import records
        from fourdgs.quantization import morton_order

        if len(cloud) == 0:
            return
        if self._steps is None:
            self._begin(cloud.scale)
        order = morton_order(cloud.xyz)
        streams = b"".join(self._streams(cloud, order, window))
        chunk = records.encode_chunk(start, end, 0, len(cloud), streams)
        offset = self._stream.tell()
        self._stream.write(chunk)
        bands = [self._write_band(cloud, order, band) for band in range(1, self._settings.degree + 1)]
        self._index.append(records.ChunkIndexEntry(start, end, offset, len(chunk), len(cloud), bands))
        self._count += len(cloud)
        self._lower = np.minimum(self._lower, cloud.xyz.min(axis=0))
        self._upper = np.maximum(self._upper, cloud.xyz.max(axis=0))

    def _streams(self, cloud: SplatCloud, order: NDArray[np.int64], window: int) -> list[bytes]:
        """Return the attributes of a chunk. Splats neither move nor fade, so that four of them are zero."""
        from fourdgs import opcode
        from fourdgs.quantization import quantize, quantize_rotation, rct_forward
        from fourdgs.serialization import encode_stream

        steps, count = self._steps, len(cloud)
        largest, rotation = quantize_rotation(cloud.rotation[order][:, [1, 2, 3, 0]], steps.rot)
        scale = np.log(np.maximum(cloud.scale[order].astype(np.float64), SMALLEST_SCALE))
        zeros, ones = np.zeros(count, np.int64), np.ones(count, np.int64)
        attributes: list[tuple[int, NDArray[np.int64]]] = [
            (opcode.A_POSITION, quantize(cloud.xyz[order], steps.pos)),
            (opcode.A_SCALE, quantize(scale, steps.scale_log)),
            (opcode.A_ROTATION_INDEX, largest),
            (opcode.A_ROTATION, rotation),
            (opcode.A_COLOR, rct_forward(quantize(cloud.base_colour[order], steps.rgb))),
            (opcode.A_OPACITY, quantize(cloud.opacity[order], steps.alpha)),
            (opcode.A_MOTION, np.zeros((count, 3), np.int64)),
            (opcode.A_MU_T, zeros),
            (opcode.A_SIGMA_T, zeros),
            (opcode.A_FLAGS, ones),
            (opcode.A_WINDOW_INDEX, window * ones),
        ]
        return [encode_stream(name, each, channels=1 if each.ndim == 1 else 3) for name, each in attributes]

    def _write_band(self, cloud: SplatCloud, order: NDArray[np.int64], band: int) -> tuple[int, int, int]:
        """Write the spherical harmonics of one degree. Returns the degree, and the offset and size of the record."""
        from fourdgs import opcode
        from fourdgs.quantization import SH_QUANT_HI, SH_QUANT_LO
        from fourdgs.serialization import encode_stream, put_record, put_u8

        first, last = _BANDS[band]
        values = cloud.sh[order, :, first:last].reshape(len(cloud), -1)
        codes = np.rint((values - SH_QUANT_LO) * (255 / (SH_QUANT_HI - SH_QUANT_LO)))
        stream = encode_stream(opcode.SH_BAND_STREAM, np.clip(codes, 0, 255).astype(np.int64), channels=codes.shape[1])
        offset = self._stream.tell()
        record = put_record(opcode.SH_BAND_STREAM, put_u8(band) + stream)
        self._stream.write(record)
        return band, offset, len(record)

    def _begin(self, scale: NDArray[np.floating[Any]]) -> None:
        """Write the records before the first chunk. The precision depends on the size of the first splats."""
        from fourdgs import records
        from fourdgs.quantization import Bounds, Steps
        from fourdgs.serialization import MAGIC

        settings = self._settings
        bounds = Bounds.for_profile(PROFILE, median_scale=float(np.median(scale)) if len(scale) else DEFAULT_SCALE)
        steps = self._steps = Steps.of(bounds)
        quantization = records.Quantization(
            scheme="uniform-v1",
            pos_origin=[0.0, 0.0, 0.0],
            step_pos=steps.pos,
            step_scale_log=steps.scale_log,
            step_rot=steps.rot,
            step_rgb=steps.rgb,
            step_alpha=steps.alpha,
            step_motion=steps.motion,
            step_time=steps.time,
            step_sigma_log=steps.sigma_log,
            step_sh=steps.sh,
            bounds=bounds.as_strings(),
        )
        times = [(index / settings.fps, (index + 1) / settings.fps) for index in range(settings.frames)]
        windows = records.WindowTable(windows=[*times, (0.0, settings.seconds)])
        frame = records.CoordinateFrame("", _RIGHT_HANDED, _UP, _FORWARD, 0, settings.metres_per_unit or 0.0)
        parts = [MAGIC, self._header(), quantization.encode(), windows.encode()]
        parts += [frame.encode()] if settings.has_up_y else []
        view = settings.view
        if view is not None:
            parts.append(records.Camera(view.fov_y_degrees, list(view.position), list(view.target)).encode())
        self._stream.write(b"".join(parts))

    def _header(self) -> bytes:
        """Return the header. Its length does not depend on the number and the positions of the splats."""
        from fourdgs import records

        bounds = [*self._lower, *self._upper] if self._count else [0.0] * 6
        header = records.Header(
            duration_sec=self._settings.seconds,
            gaussian_count=self._count,
            aabb=[float(value) for value in bounds],
            library="fourd",
            sh_degree=self._settings.degree,
            attributes={RATE_ATTRIBUTE: repr(float(self._settings.fps))},
        )
        return bytes(header.encode())
