"""Bounding volume hierarchies of triangles: :class:`Bvh`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import cuda_unavailable_reason
from fourd.rendering.ops.meshes.checks import check_tensor, check_triangles
from fourd.rendering.ops.rays.op import build_tree, refit_tree, tree_cost


@dataclass(frozen=True)
class Bvh:
    """A bounding volume hierarchy of a mesh's triangles, for :func:`~fourd.rendering.rays.tracing.trace`.

    Use :meth:`build` to create a tree. Trees are immutable, so :meth:`refit` and :meth:`update` return new ones.

    Attributes:
        xyz: (V, 3) float32 detached copy of the vertex positions for which the tree was built or refitted.
        triangles: (T, 3) int32 vertex indices.
        nodes: (N, 64) float32; each row has the 256 raw bytes of one tree node, a C++ struct.
        blocks: (B, 80) float32; each row has the 320 raw bytes of one block of up to eight triangles.
        magnitude: largest absolute coordinate of the triangles, in world units.
        cost_when_built: value of :attr:`cost` when the tree was built.
    """

    xyz: Tensor
    triangles: Tensor
    nodes: Tensor
    blocks: Tensor
    magnitude: float
    cost_when_built: float

    @classmethod
    def build(cls, xyz: Tensor, triangles: Tensor, *, threads: int = 0) -> Bvh:
        """Build a tree with the surface area heuristic, always on the CPU.

        Args:
            xyz: (V, 3) float32 vertex positions in world units, on the CPU or a CUDA device. The tree keeps a copy.
                Triangles with a coordinate that is not finite or exceeds 1e18 in absolute value are never hit.
            triangles: (T, 3) int32 vertex indices, on the same device. T may be 0.
            threads: number of threads; 0 means the environment variable FOURD_THREADS, or torch.get_num_threads(). The
                tree is the same for any number of threads.

        Raises:
            TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
            RuntimeError: for a CUDA tensor if fourd was built without CUDA.
        """
        check_tensor("xyz", xyz, ("V", 3))
        tri = check_triangles(triangles, xyz.shape[0], ("xyz", xyz))
        if xyz.device.type == "cuda" and (missing := cuda_unavailable_reason()):
            raise RuntimeError(f"xyz: expected a CPU tensor, because fourd was built without CUDA ({missing})")
        positions = xyz.detach().clone(memory_format=torch.contiguous_format)
        nodes, blocks, magnitude = build_tree(positions, tri, threads)
        return cls(positions, tri, nodes, blocks, magnitude, tree_cost(nodes, blocks))

    @property
    def cost(self) -> float:
        """Expected number of boxes that a random ray hits, given that it hits the mesh's bounding box."""
        return tree_cost(self.nodes, self.blocks)

    def refit(self, xyz: Tensor, *, threads: int = 0) -> Bvh:
        """Return a tree with the same structure, fitted to the moved vertices ``xyz``. Hits remain exact, but tracing
        becomes slower if neighbouring triangles move apart.

        Args:
            xyz: (V, 3) float32 positions, of the same number of vertices and on the same device as :attr:`xyz`.
            threads: as in :meth:`build`.

        Raises:
            TypeError, ValueError: for an invalid argument, for example a different number of vertices.
        """
        check_tensor("xyz", xyz, ("V", 3), like=("the tree's xyz", self.xyz))
        if xyz.shape != self.xyz.shape:
            raise ValueError(
                f"xyz: expected the {self.xyz.shape[0]} vertices that the tree was built for, got {xyz.shape[0]}; "
                "build a new tree with Bvh.build"
            )
        positions = xyz.detach().clone(memory_format=torch.contiguous_format)
        nodes, blocks, magnitude = refit_tree(positions, self.triangles, self.nodes, self.blocks, threads)
        return replace(self, xyz=positions, nodes=nodes, blocks=blocks, magnitude=magnitude)

    def update(self, xyz: Tensor, *, rebuild_above: float = 1.5, threads: int = 0) -> Bvh:
        """Return the tree refitted to moved vertices, or a newly built tree if the refitted tree's cost is more than
        ``rebuild_above`` times :attr:`cost_when_built`."""
        refitted = self.refit(xyz, threads=threads)
        if refitted.cost <= rebuild_above * self.cost_when_built:
            return refitted
        return Bvh.build(xyz, self.triangles, threads=threads)

    def require_positions(self, xyz: Tensor) -> None:
        """Raise a ValueError unless ``xyz`` equals the positions for which the tree was built or refitted."""
        # The comparison is bitwise, because positions may be NaN.
        given = xyz.detach().to(self.xyz.dtype).contiguous()
        is_same = xyz.shape == self.xyz.shape and xyz.device == self.xyz.device
        if not is_same or not torch.equal(given.view(torch.int32), self.xyz.view(torch.int32)):
            raise ValueError(
                "xyz: expected the positions that the tree was built for or refitted to, got other positions; "
                "call bvh = bvh.refit(xyz) first"
            )
