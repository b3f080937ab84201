"""Settings of mesh fitting."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FitSettings:
    """Settings for fitting a frame's surface to its views.

    Attributes:
        steps: number of gradient steps, 0 or more. If 0, the mesh is the surface of the visual hull.
        rate: initial learning rate of the signed distances and vertex offsets of the tetrahedral grid, more than 0, in
            units of the side length of the grid's cubes. It falls to a tenth at the last step.
        silhouette: weight of the squared difference between rendered and given mattes.
        photo: weight of the colour difference between different views of the same surface point.
        laplacian: weight of :func:`fourd.reconstruction.meshes.surface.losses.laplacian_loss`, computed with lengths in
            units of the side length of the grid's cubes.
        normal: weight of :func:`fourd.reconstruction.meshes.surface.losses.normal_consistency_loss`.
        sources: number of nearby views with which the photo loss compares the view of a gradient step.
        seed: seed of the random order of the views.
    """

    steps: int = 200
    rate: float = 0.03
    silhouette: float = 4.0
    photo: float = 2.0
    laplacian: float = 0.3
    normal: float = 0.03
    sources: int = 3
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError for a value that is out of range."""
        if self.steps < 0:
            raise ValueError(f"steps: expected 0 or more, got {self.steps}")
        if not self.rate > 0:
            raise ValueError(f"rate: expected more than 0, got {self.rate}")
        if self.sources < 1:
            raise ValueError(f"sources: expected at least 1, got {self.sources}")
        for name in ("silhouette", "photo", "laplacian", "normal"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: expected a weight of 0 or more, got {getattr(self, name)}")
