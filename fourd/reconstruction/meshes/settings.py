"""Settings of the meshes of a capture."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from fourd.reconstruction.meshes.fitting.settings import FitSettings

MAX_TEXTURE_SIZE = 16384
MeshFormat = Literal["glb", "ply"]


@dataclass(frozen=True)
class MeshSettings:
    """Settings of the meshes of a capture.

    Attributes:
        cells: number of cubes of the grid along the longest side of the subject, at least 8.
        texture_size: side length of the texture in texels, from 16 to 16384.
        format: "glb" for textured meshes in GLB files and an animation, "ply" for meshes with vertex colours.
        agreement: a fraction in (0, 1]. A point belongs to the hull only if it is inside the mattes of at least this
            fraction of the views that see it.
        least_views: a fraction in (0, 1]. A point belongs to the hull only if it is seen by at least this fraction of
            all views.
        trim: whether to remove protruding parts of the hull before fitting. The remaining hull still covers all mattes.
        remesh: target edge length of isotropic remeshing, as a multiple of the grid's cell size. If 0, the mesh is not
            remeshed.
        fit: settings of the fit.
    """

    cells: int = 96
    texture_size: int = 1024
    format: MeshFormat = "glb"
    agreement: float = 0.95
    least_views: float = 1 / 2
    trim: bool = False
    remesh: float = 0.0
    fit: FitSettings = field(default_factory=FitSettings)

    def __post_init__(self) -> None:
        """Raise ValueError for a value that is out of range."""
        if self.cells < 8:
            raise ValueError(f"cells: expected at least 8, got {self.cells}")
        if not 16 <= self.texture_size <= MAX_TEXTURE_SIZE:
            raise ValueError(f"texture_size: expected 16 to {MAX_TEXTURE_SIZE} texels, got {self.texture_size}")
        if not self.remesh >= 0:
            raise ValueError(f"remesh: expected 0 or more cubes, got {self.remesh}")
        if self.format not in ("glb", "ply"):
            raise ValueError(f"format: expected glb or ply, got {self.format}")
