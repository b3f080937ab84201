"""Rasterization of a mesh in layers, from the nearest triangle at each pixel to the farthest: :class:`DepthPeeler`."""

from __future__ import annotations

from types import TracebackType

from torch import Tensor

from fourd.rendering.ops.meshes.backends import select_backend
from fourd.rendering.ops.meshes.checks import check_resolution
from fourd.rendering.ops.rasterize.op import rasterize_triangles
from fourd.rendering.ops.rasterize.reference import rasterize_triangles_reference
from fourd.rendering.triangles.rasterization import check_mesh


class DepthPeeler:
    """Rasterizes a mesh layer by layer, from front to back.

    At each pixel, the triangles are ordered by z/w, and by index at equal z/w. Layer k shows the triangle at position k
    of this order, starting with k = 0, so coincident triangles are in consecutive layers. If a pixel shows no triangle
    in one layer, it shows none in any later layer.

    Usage::

        with DepthPeeler(pos, tri, (height, width)) as peeler:
            for _ in range(layers):
                rast, rast_db = peeler.rasterize_next_layer()
    """

    def __init__(
        self,
        pos: Tensor,
        tri: Tensor,
        resolution: tuple[int, int],
        *,
        ranges: Tensor | None = None,
        grad_db: bool = True,
        output_db: bool = True,
        backend: str = "auto",
        threads: int = 0,
    ) -> None:
        """See :func:`fourd.rendering.triangles.rasterize` for the arguments and the errors."""
        self._pos, self._tri, self._ranges = check_mesh(pos, tri, ranges)
        self._size = check_resolution(resolution)
        self._outputs = (output_db, grad_db)
        self._threads = threads
        self._is_reference = select_backend(backend, "pos", pos) == "reference"
        self._previous: Tensor | None = None
        self._is_open = False

    def __enter__(self) -> DepthPeeler:
        self._previous = None
        self._is_open = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._previous = None
        self._is_open = False

    def rasterize_next_layer(self) -> tuple[Tensor, Tensor]:
        """Return ``rast`` and ``rast_db`` of the next layer, in the format of
        :func:`fourd.rendering.triangles.rasterize`. The first call in the ``with`` block returns the nearest layer.

        Raises:
            RuntimeError: if the call is outside a ``with`` block.
        """
        if not self._is_open:
            raise RuntimeError("DepthPeeler: expected a call inside `with DepthPeeler(...) as peeler:`")
        mesh = (self._pos, self._tri, self._ranges, self._previous, *self._size, *self._outputs)
        if self._is_reference:
            rast, rast_db = rasterize_triangles_reference(*mesh)
        else:
            rast, rast_db = rasterize_triangles(*mesh, self._threads)
        self._previous = rast.detach()
        return rast, rast_db
