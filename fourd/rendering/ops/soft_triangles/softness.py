"""The parameters of soft rasterization."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Softness:
    """Parameters of soft rasterization (SoftRas, Liu et al. 2019).

    Attributes:
        barycentric: True to use a pixel's smallest barycentric coordinate as its distance from a triangle's edges,
            instead of the Euclidean distance.
        sigma: squared width of the soft edges, in the unit of the squared distance from the edges.
        gamma: temperature of the depth softmax.
        cutoff: a triangle is skipped at pixels where its soft coverage D is below this number, which is in (0, 0.5).
        near, far: range of camera depths, in world units.
        eps: normalised depth of the background, from 0 at ``far`` to 1 at ``near``.
    """

    barycentric: bool
    sigma: float
    gamma: float
    cutoff: float
    near: float
    far: float
    eps: float

    def pack(self) -> list[float]:
        """Return the parameters as the list of numbers that the kernels expect."""
        return [float(self.barycentric), self.sigma, self.gamma, self.cutoff, self.near, self.far, self.eps]
