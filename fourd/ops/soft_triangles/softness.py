"""The parameters of soft rasterization."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Softness:
    """Parameters of soft rasterization (SoftRas, Liu et al. 2019).

    Attributes:
        barycentric: whether the distance of a pixel from a triangle's edges is the smallest barycentric coordinate of
            the pixel instead of a Euclidean distance.
        sigma: width of the edges, as a squared distance.
        gamma: temperature of the depth softmax.
        cutoff: a triangle is skipped at pixels where its coverage D, the share of the pixel that the triangle covers,
            is below this number. In (0, 0.5).
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
        """Return the parameters as the numbers that the kernels expect."""
        return [float(self.barycentric), self.sigma, self.gamma, self.cutoff, self.near, self.far, self.eps]
