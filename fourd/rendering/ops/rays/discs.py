"""Composites discs along rays, for NumPy arrays (``csrc/rays/discs.h``)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.loading import load_native, simd_name, thread_count

Array = NDArray[np.float32]

MAX_LAYERS = 64


class DiscTree:
    """An immutable bounding volume hierarchy of N discs, which several threads can use at the same time.

    Attributes:
        nodes, blocks: the tree's nodes, and the groups of discs at its leaves. Each row has the bytes of one struct
            Node (csrc/rays/rays.h) or DiscBlock (csrc/rays/discs.h), viewed as float32.
        magnitude: largest absolute coordinate of the discs' boxes, in world units.
    """

    nodes: Array
    blocks: Array
    magnitude: float

    def __init__(self, xyz: Array, radius: Array, density: Array, *, threads: int = 0) -> None:
        """Build the tree.

        Args:
            xyz: (N, 3) float32 centres in world units.
            radius: (N,) float32 radii in world units.
            density: (N,) float32 alpha at the centre; values above 1 count as 1. Discs with a non-finite value, or with
                a radius or density that is not positive, are never hit.
            threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores.

        Raises:
            ValueError: for an array of the wrong shape or dtype.
            ImportError: if the native module is not built.
        """
        self._count = len(xyz)
        _check("xyz", xyz, (self._count, 3))
        _check("radius", radius, (self._count,))
        _check("density", density, (self._count,))
        arrays = [np.ascontiguousarray(array) for array in (xyz, radius, density)]
        self.nodes, self.blocks, self.magnitude = load_native().build_discs(*arrays, thread_count(threads))

    def __len__(self) -> int:
        return self._count

    def composite(
        self,
        colours: Array,
        origins: Array,
        directions: Array,
        *,
        facing: Array | None = None,
        t_min: float = 0.0,
        t_max: float | Array = np.inf,
        layers: int = 12,
        threads: int = 0,
    ) -> Array:
        """Composite the K nearest discs of each ray, front to back.

        The discs are ordered by the ray parameter t of the hit, and by index at equal t.
        At the distance d from a disc's centre, the disc's alpha is density * (1 - d^2 / radius^2).

        Args:
            colours: (N, 3) float32 colours of the discs.
            origins, directions: (R, 3) float32. The points of a ray are ``origin + t * direction``. A ray with zero
                direction or non-finite coordinates hits nothing.
            facing: (3,) float32 normal of all discs, for example the viewing direction of a pinhole camera. If None,
                each disc faces the ray.
            t_min, t_max: only hits with t in [t_min, t_max] count. ``t_max`` is one number, or a float32 array (R,)
                with one number per ray.
            layers: number K, from 1 to 64.
            threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores.

        Returns:
            (R, 4) float32 premultiplied colours and alpha.

        Raises:
            ValueError: for an array of the wrong shape or dtype, or ``layers`` out of range.
        """
        _check("colours", colours, (self._count, 3))
        _check("origins", origins, (len(origins), 3))
        _check("directions", directions, (len(origins), 3))
        if facing is not None:
            _check("facing", facing, (3,))
        if not 1 <= layers <= MAX_LAYERS:
            raise ValueError(f"layers: expected 1 to {MAX_LAYERS}, got {layers}")
        out = np.empty((len(origins), 4), np.float32)
        limits = [np.atleast_1d(np.asarray(limit, np.float32)) for limit in (t_min, t_max)]
        arrays = [np.ascontiguousarray(array) for array in (colours, origins, directions)]
        plane = None if facing is None else np.ascontiguousarray(facing)
        tree = (self.nodes, self.blocks, self.magnitude)
        load_native().composite_discs(*tree, *arrays, *limits, plane, layers, thread_count(threads), simd_name(), out)
        return out


def _check(name: str, array: Array, shape: tuple[int, ...]) -> None:
    if array.shape != shape or array.dtype != np.float32:
        raise ValueError(f"{name}: expected float32 of shape {shape}, got {array.dtype} of shape {array.shape}")
