"""The precision with which each tier stores the points of a scene, in several levels from the finest to the
coarsest."""

from __future__ import annotations

from dataclasses import dataclass

from fourd.scene.files.encoding import Tier
from fourd.scene.packed.members import ColourRounding


@dataclass(frozen=True)
class Precision:
    """Quantisation steps and thresholds of one level. Each tier (quality of a packed scene) has several levels, see
    :data:`LEVELS`. The fields that are not listed here have the meaning that they have in
    :class:`fourd.scene.files.encoding.CloudEncoding`.

    Attributes:
        positions_per_radius: number of quantisation steps of the positions within the median radius of the points.
        colour_step: quantisation step of colours, in units of 1/255. It is at least 2, because colour differences,
            which range from -255 to 255, are divided by it and stored as signed bytes.
        mean_colour_step: step to which mean colours are rounded, in units of 1/255.
        unseen_colour_step: step to which a point's colours are rounded in views with a blend weight of 0, in units of
            1/255. If None, these colours are replaced by the point's mean colour.
        min_visibility: dynamic points are left out if their visibility, in [0, 1], is below this minimum in all views
            of :func:`fourd.scene.colour_fit.viewpoints`.
        crf: constant quality of the source-view images, from 0 (best) to 63. If None, the colours are stored for each
            point instead.
        texels_per_radius: resolution of the source-view images. For each source view, the median radius of the visible
            points in pixels is computed. The largest of these medians spans this number of image texels.
    """

    positions_per_radius: int
    radius_steps: int
    density_levels: int
    sh_step: float
    weight_steps: int = 1
    colour_step: int = 2
    mean_colour_step: int = 1
    unseen_colour_step: int | None = None
    min_visibility: float = 0.0
    crf: int | None = None
    texels_per_radius: float = 2.0

    @property
    def colour_rounding(self) -> ColourRounding:
        """How colours are rounded before they are stored."""
        return ColourRounding(self.mean_colour_step, self.unseen_colour_step or self.colour_step)


LEVELS: dict[Tier, tuple[Precision, ...]] = {
    "full": (
        Precision(96, 64, 127, 1 / 48, 4, 2, 2, unseen_colour_step=32),
        Precision(96, 64, 63, 1 / 32, 3, 4, 2, unseen_colour_step=64),
    ),
    "stream": (
        Precision(48, 32, 31, 1 / 16, 2, 4, 6, min_visibility=0.05),
        Precision(32, 32, 31, 1 / 12, 2, 4, 6, min_visibility=0.1),
        Precision(24, 32, 15, 1 / 8, 1, 6, 8, min_visibility=0.1),
        Precision(24, 16, 15, 1 / 6, 1, 8, 8, min_visibility=0.15),
        Precision(16, 16, 15, 1 / 4, 1, 12, 8, min_visibility=0.2),
        Precision(12, 16, 7, 1 / 4, 1, 16, 12, min_visibility=0.25),
        Precision(8, 8, 7, 1 / 3, 1, 24, 12, min_visibility=0.3),
    ),
    "video": (
        Precision(32, 32, 31, 1 / 12, 2, mean_colour_step=6, min_visibility=0.1, crf=24),
        Precision(24, 32, 15, 1 / 8, 1, mean_colour_step=8, min_visibility=0.1, crf=32),
        Precision(24, 16, 15, 1 / 6, 1, mean_colour_step=8, min_visibility=0.15, crf=36),
        Precision(16, 16, 15, 1 / 4, 1, mean_colour_step=8, min_visibility=0.2, crf=40),
    ),
    "light": (
        Precision(32, 32, 31, 1 / 24, min_visibility=0.05),
        Precision(24, 16, 31, 1 / 16, min_visibility=0.1),
        Precision(16, 16, 15, 1 / 12, min_visibility=0.1),
        Precision(12, 8, 15, 1 / 8, min_visibility=0.2),
        Precision(8, 8, 15, 1 / 6, min_visibility=0.25),
        Precision(6, 8, 7, 1 / 4, min_visibility=0.3),
    ),
}
"""For each tier (quality of a packed scene), its levels of precision, from the finest to the coarsest."""

DEFAULT_LEVELS: dict[Tier, int] = {"full": 1, "stream": 2, "video": 1, "light": 1}
"""Index of the level that each tier uses if no data rate is given."""
