"""The operations of :mod:`fourd.rendering.triangles` under the names and arguments of ``nvdiffrast.torch``.

A script that was written for ``nvdiffrast.torch`` runs with ``import fourd.rendering.nvdiffrast as dr``. Each operation
runs on the device of its tensors. For a script that places its tensors on a CUDA device, :func:`run_on_cpu` redirects
these calls to the CPU, and ``python -m fourd.rendering.nvdiffrast SCRIPT`` runs it without a change.
"""

from fourd.rendering.nvdiffrast.operations import (
    DepthPeeler,
    RasterizeCudaContext,
    RasterizeGLContext,
    antialias,
    antialias_construct_topology_hash,
    get_log_level,
    interpolate,
    rasterize,
    set_log_level,
    texture,
    texture_construct_mip,
)
from fourd.rendering.nvdiffrast.redirection import CpuRun, run_on_cpu

__all__ = [
    "CpuRun",
    "DepthPeeler",
    "RasterizeCudaContext",
    "RasterizeGLContext",
    "antialias",
    "antialias_construct_topology_hash",
    "get_log_level",
    "interpolate",
    "rasterize",
    "run_on_cpu",
    "set_log_level",
    "texture",
    "texture_construct_mip",
]
