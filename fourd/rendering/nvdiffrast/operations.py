"""The operations of :mod:`fourd.rendering.triangles` under the names and arguments of ``nvdiffrast.torch``.

:mod:`fourd.rendering.nvdiffrast.arguments` accepts the arguments that nvdiffrast accepts and fourd.rendering.triangles
does not.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from fourd.rendering import triangles
from fourd.rendering.nvdiffrast import arguments

_LOGGER = "fourd.rendering.nvdiffrast"
_LOG_LEVELS = (logging.INFO, logging.WARNING, logging.ERROR, logging.CRITICAL)


class RasterizeCudaContext:
    """Replaces nvdiffrast's class of the same name. It holds no resources and ignores ``device``."""

    output_db = True

    def __init__(self, device: torch.device | str | int | None = None) -> None:
        pass


class RasterizeGLContext:
    """Replaces nvdiffrast's class of the same name. It holds no resources, and ``mode`` and ``device`` have no effect.

    Attributes:
        output_db: whether :func:`rasterize` computes ``rast_db``. If False, ``rast_db`` has the shape (B, H, W, 0).
    """

    def __init__(
        self, output_db: bool = True, mode: str = "automatic", device: torch.device | str | int | None = None
    ) -> None:
        if mode not in ("automatic", "manual"):
            raise ValueError(f"mode: expected 'automatic' or 'manual', got {mode!r}")
        self.output_db = output_db

    def set_context(self) -> None:
        """Does nothing."""

    def release_context(self) -> None:
        """Does nothing."""


Context = RasterizeCudaContext | RasterizeGLContext


def rasterize(
    glctx: Context,
    pos: Tensor,
    tri: Tensor,
    resolution: Sequence[int],
    ranges: Tensor | None = None,
    grad_db: bool = True,
) -> tuple[Tensor, Tensor]:
    """See :func:`fourd.rendering.triangles.rasterize`. ``ranges`` is ignored if ``pos`` is (B, V, 4), and triangles
    with a vertex index out of range are not drawn; both give a warning."""
    has_db = _has_db(glctx)
    tri, ranges = arguments.mesh(pos, tri, ranges)
    return triangles.rasterize(pos, tri, _size(resolution), ranges=ranges, output_db=has_db, grad_db=grad_db and has_db)


class DepthPeeler(triangles.DepthPeeler):
    """See :class:`fourd.rendering.triangles.DepthPeeler`."""

    def __init__(
        self,
        glctx: Context,
        pos: Tensor,
        tri: Tensor,
        resolution: Sequence[int],
        ranges: Tensor | None = None,
        grad_db: bool = True,
    ) -> None:
        has_db = _has_db(glctx)
        tri, ranges = arguments.mesh(pos, tri, ranges)
        super().__init__(pos, tri, _size(resolution), ranges=ranges, output_db=has_db, grad_db=grad_db and has_db)


def interpolate(
    attr: Tensor,
    rast: Tensor,
    tri: Tensor,
    rast_db: Tensor | None = None,
    diff_attrs: Literal["all"] | Sequence[int] | np.ndarray | None = None,
) -> tuple[Tensor, Tensor]:
    """See :func:`fourd.rendering.triangles.interpolate`. ``rast_db`` is ignored if ``diff_attrs`` selects no channel.
    Channels beyond those of ``attr`` have the derivatives 0, and pixels whose triangle has a vertex index out of range
    have the value 0; both give a warning."""
    channels = arguments.channels(diff_attrs, attr)
    tri, rast = arguments.shown_triangles(attr, rast, tri)
    known = [channel for channel in channels if -attr.shape[-1] <= channel < attr.shape[-1]]
    out, out_da = triangles.interpolate(attr, rast, tri, rast_db if known else None, known)
    return out, arguments.spread(out_da, channels, known)


def texture(
    tex: Tensor,
    uv: Tensor,
    uv_da: Tensor | None = None,
    mip_level_bias: Tensor | None = None,
    mip: Any = None,
    filter_mode: Any = "auto",
    boundary_mode: Any = "wrap",
    max_mip_level: int | None = None,
) -> Tensor:
    """See :func:`fourd.rendering.triangles.texture`. ``uv_da`` and ``mip_level_bias`` are ignored if ``filter_mode``
    uses no mip levels, and ``max_mip_level`` limits only the levels that are built in this call, unless it is 0."""
    most = None if max_mip_level is None else int(max_mip_level)
    if mip is not None and most != 0:
        most = None
    filter_mode, uv_da, bias = arguments.level_inputs(filter_mode, uv_da, mip_level_bias)
    return triangles.texture(tex, uv, uv_da, bias, mip, filter_mode, boundary_mode, most)


def texture_construct_mip(tex: Tensor, max_mip_level: int | None = None, cube_mode: bool = False) -> triangles.Mip:
    """See :func:`fourd.rendering.triangles.texture_construct_mip`."""
    most = None if max_mip_level is None else int(max_mip_level)
    return triangles.texture_construct_mip(tex, most, cube_mode)


def antialias(
    color: Tensor,
    rast: Tensor,
    pos: Tensor,
    tri: Tensor,
    topology_hash: triangles.Topology | None = None,
    pos_gradient_boost: float = 1.0,
) -> Tensor:
    """See :func:`fourd.rendering.triangles.antialias`. Triangles with a vertex index out of range are ignored, with a
    warning."""
    tri, _ = arguments.usable_triangles(tri, pos.shape[-2])
    return triangles.antialias(color, rast, pos, tri, topology_hash, pos_gradient_boost)


def antialias_construct_topology_hash(tri: Tensor) -> triangles.Topology:
    """See :func:`fourd.rendering.triangles.antialias_construct_topology`."""
    return triangles.antialias_construct_topology(arguments.usable_triangles(tri, 2**31 - 1)[0])


def set_log_level(level: int) -> None:
    """Set the level of the logger ``fourd.rendering.nvdiffrast``: 0 for information, 1 for warnings, 2 for errors, or 3
    for fatal errors. The operations themselves log no messages."""
    if level not in range(len(_LOG_LEVELS)):
        raise ValueError(f"level: expected 0 to {len(_LOG_LEVELS) - 1}, got {level!r}")
    logging.getLogger(_LOGGER).setLevel(_LOG_LEVELS[level])


def get_log_level() -> int:
    """Return the level that :func:`set_log_level` has set, initially 1."""
    level = logging.getLogger(_LOGGER).level
    return _LOG_LEVELS.index(level) if level in _LOG_LEVELS else 1


def _size(resolution: Sequence[int]) -> tuple[int, int]:
    if len(resolution) != 2:
        raise ValueError(f"resolution: expected [height, width], got {list(resolution)}")
    return int(resolution[0]), int(resolution[1])


def _has_db(glctx: object) -> bool:
    if not isinstance(glctx, RasterizeCudaContext | RasterizeGLContext):
        expected = "a RasterizeCudaContext or a RasterizeGLContext"
        raise TypeError(f"glctx: expected {expected} as the first argument, got {type(glctx).__name__}")
    return glctx.output_db
