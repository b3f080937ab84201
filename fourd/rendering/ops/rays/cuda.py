"""Composites discs along rays on a GPU, for torch tensors."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, load_gpu
from fourd.rendering.ops.loading import as_array
from fourd.rendering.ops.meshes.checks import check_tensor
from fourd.rendering.ops.rays.discs import MAX_LAYERS, DiscTree


class GpuDiscTree:
    """A bounding volume hierarchy of N discs in device memory. For CPU tensors, the kernel runs in the emulator
    (:mod:`fourd.rendering.ops.gpu`).

    The colours are bit-identical to those of :class:`fourd.rendering.ops.rays.discs.DiscTree`.
    """

    def __init__(self, xyz: Tensor, radius: Tensor, density: Tensor, *, threads: int = 0) -> None:
        """Build the tree on the CPU and copy it to the device of ``xyz``.

        The arguments are those of :class:`fourd.rendering.ops.rays.discs.DiscTree`, except that the arrays are float32
        tensors on one device.

        Raises:
            TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
            ImportError: if the kernels of the device are not built.
        """
        check_tensor("xyz", xyz, ("N", 3))
        for name, values in (("radius", radius), ("density", density)):
            check_tensor(name, values, (len(xyz),), like=("xyz", xyz))
        self._gpu = load_gpu(xyz.device)
        self._like = xyz[:0].detach()
        self._count = len(xyz)
        tree = DiscTree(*(as_array(tensor.cpu()) for tensor in (xyz, radius, density)), threads=threads)
        self._tree = (*(torch.from_numpy(rows).to(xyz.device) for rows in (tree.nodes, tree.blocks)), tree.magnitude)

    def composite(
        self,
        colours: Tensor,
        origins: Tensor,
        directions: Tensor,
        *,
        facing: Tensor | None = None,
        t_min: float = 0.0,
        t_max: float | Tensor = torch.inf,
        layers: int = 12,
    ) -> Tensor:
        """Composite the ``layers`` nearest discs of each ray, as
        :meth:`fourd.rendering.ops.rays.discs.DiscTree.composite` does.

        The arguments are float32 tensors on the tree's device, and gradients are not supported. The work is queued on
        torch's current stream, and the call returns before it finishes.

        Returns:
            (R, 4) float32 premultiplied colours and alpha, on the device.

        Raises:
            TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
        """
        like = ("the tree's xyz", self._like)
        check_tensor("colours", colours, (self._count, 3), like=like)
        check_tensor("origins", origins, ("R", 3), like=like)
        check_tensor("directions", directions, (len(origins), 3), like=like)
        if facing is not None:
            check_tensor("facing", facing, (3,), like=like)
        if not 1 <= layers <= MAX_LAYERS:
            raise ValueError(f"layers: expected 1 to {MAX_LAYERS}, got {layers}")
        limits = [origins.new_tensor([t_min])]
        if isinstance(t_max, Tensor):
            limits.append(contiguous(check_tensor("t_max", t_max, (len(origins),), like=like)))
        else:
            limits.append(origins.new_tensor([t_max]))
        arrays = [contiguous(tensor) for tensor in (colours, origins, directions)]
        plane = None if facing is None else contiguous(facing)
        out = origins.new_empty(len(origins), 4)
        with self._gpu.activate():
            self._gpu.kernels.composite_discs(*self._tree, *arrays, *limits, plane, layers, self._gpu.stream, out)
        return out
