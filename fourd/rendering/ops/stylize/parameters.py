"""The inputs of the stylizer: an image's visible surface, and the parameters of a style for one camera.

A pixel has the albedo F (colour / alpha), the coverage s, the unit normal N and the camera depth z. V is the unit
vector towards the camera, and L is the unit vector towards the light. clamp(x) limits x to [0, 1]. The stylizer
performs these steps:

- Closing gaps. Points leave gaps through which a farther surface is visible. A pixel is in a gap if nearer surfaces
  lie on both sides of it, in its row or in its column, at most three pixels away. Of these two surfaces, the pixel
  gets the depth and the normal of the farther one.
- Tone t = (1 + N.L) / 2 and detail d. The style selects d = N.V, clamp(o + p * z) or clamp(abs(o + p * z)), where o is
  ``detail_offset`` and p is ``detail_per_depth`` of :class:`Numbers`.
- Colour C = S(t, d) * (a + b * F) + c * F, where S is the shade table, and a, b and c are ``table_alone``,
  ``table_times_albedo`` and ``albedo_alone``. Toon and X-Toon styles (Barla et al. 2006) have c = 0, and only in X-Toon
  styles does S depend on d. Styles after Gooch et al. (1998) have a = 1 and b = 0, and S ranges from the cool colour to
  the warm colour. Where N.V is below ``angle_threshold``, C is mixed with ``angle_colour``.
- Hatching with two layers of parallel lines. The lines widen where sqrt(t * g) is low, where g is the grey value of F.
- Lines of strength e. A Sobel filter or a cross filter on 1 / z and on the cosines between normals finds the lines
  (Saito and Takahashi 1990). If the line state of the previous image is given, lines fade in where the surface is at
  rest: a line with the previous strength e_before < e gets the strength e + ``persistence`` * (e_before - e). The
  surface is at rest at a pixel if the sum of the inverse depths at the filter's nine taps differs by at most 3% between
  the previous and the new image.
- Lines near holes. The back of a surface is visible only through holes between the points, around which depths are
  irregular. A line is therefore removed if a filter tap shows the back of a surface, unless another tap shows no
  surface: the line then belongs to the subject's outline.
- Specks, which are very short lines, are not drawn. Consider the squares around a pixel with sides of 2, 4, 8, ...,
  2 * r pixels, where r is the result of ``speck_reach``. The line at the pixel is drawn only if each of these squares
  has a line of at least the strength LEAST_STRENGTH on one or more of its sides. The line state still contains the
  specks.
- Output image. C is composited with opacity s over ``paper``, the colour behind the surface. The line colour is
  composited over the result with opacity ``line_opacity`` * e.

The cross filter draws no lines on planes: the inverse depth 1 / z of a plane is linear in the pixel position, so the
second differences of 1 / z, which the filter uses, are 0.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.aligned import zeros_aligned

TONES = 256
"""Number of columns of a shade table, which contains colours S(t, d). Columns are tones t, and rows are details d."""
MAX_ROWS = 64
"""Maximum number of rows of a shade table."""
GAP = 3
"""Gaps between points, through which a farther surface is visible, are filled. A pixel is in a gap if nearer surfaces
lie on both sides of it, in its row or in its column, at most this number of pixels away."""
MAX_THICKNESS = 8
"""Maximum number of pixels between the taps of a line filter."""

SAME_TAPS = 0.03
"""Lines fade in only at pixels where the surface is at rest. The surface is at rest if the sum of the inverse depths at
the line filter's taps changes by at most this fraction from the previous image to the new one."""

BACK_WEIGHT = 0.1
"""A visible surface's depth and normal are weighted means over points. Points whose normals face away from the camera
have this weight, and points whose normals face the camera have the weight 1."""
FRONT_SLOPE = 8.0
"""Slope with which lines fade near the backs of surfaces. Let m be the largest dot product of the pixel's ray with the
normals at the filter's taps, which is positive for normals that point away from the camera. A line has full strength at
m = 0, and strength 0 at m = 1 / FRONT_SLOPE."""


def speck_reach(thickness: int) -> int:
    """Return half the side length, in pixels, of the largest square around a pixel that is used to find specks. A line
    at the pixel that does not reach the sides of this square is a speck. The result is the largest power of 2 that is
    at most ``4 * (thickness + 1)``.
    """
    return 1 << (4 * (thickness + 1)).bit_length() - 1


LEAST_STRENGTH = 32
"""Strength, on a scale from 0 to 255, below which the search for specks ignores lines on the sides of the squares
around a pixel (see :func:`speck_reach`)."""


Detail = Literal["facing", "depth", "focus"]
LineFilter = Literal["none", "sobel", "cross"]
DETAILS: tuple[Detail, ...] = ("facing", "depth", "focus")
LINE_FILTERS: tuple[LineFilter, ...] = ("none", "sobel", "cross")
Triple = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Surface:
    """The visible surface of an image.

    Attributes:
        albedo: (H, W, 4) uint8 premultiplied RGB, and alpha.
        inverse_depth: (H, W) float32 coverage divided by mean camera depth, in 1 / world units, 0 where there is no
            surface. The coverage is clamp(3 * alpha - 0.5, 0, 1). In the mean depth, points whose normals face away
            from the camera have a small weight (``front_weight`` in fourd/rendering/ops/stylize/reference.py).
        normal: (H, W, 4) uint8 values 127 * n + 128 (three channels) and 255 * coverage. n is the outward unit normal
            in the camera frame, or 0 where there is no surface.
    """

    albedo: NDArray[np.uint8]
    inverse_depth: NDArray[np.float32]
    normal: NDArray[np.uint8]

    @classmethod
    def empty(cls, height: int, width: int) -> Surface:
        """Create the surface of an image that shows nothing."""
        albedo, normal = zeros_aligned((height, width, 4), np.uint8), zeros_aligned((height, width, 4), np.uint8)
        normal[..., :3] = 128
        return cls(albedo, zeros_aligned((height, width), np.float32), normal)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.inverse_depth.shape
        return height, width

    @property
    def depth(self) -> NDArray[np.float32]:
        """(H, W) camera depth in world units, infinity where there is no surface."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.inverse_depth > 0, self.coverage / self.inverse_depth, np.float32(np.inf))

    @property
    def coverage(self) -> NDArray[np.float32]:
        """(H, W) coverage in [0, 1]."""
        return (self.normal[..., 3] / 255).astype(np.float32)

    @property
    def unit_normal(self) -> NDArray[np.float32]:
        """(H, W, 3) unit normals in the camera frame."""
        return (self.normal[..., :3].astype(np.float32) - 128) / np.float32(127)


@dataclass(frozen=True)
class Numbers:
    """The numeric parameters of a style for one camera. Lengths are in pixels, colours are in [0, 1]. The module's
    docstring defines the symbols and contains the formulas.

    Attributes:
        ray: six numbers that define the ray through the image point (x, y), scaled to depth 1:
            ``(ray[0] * x + ray[1] * y + ray[2], ray[3] * x + ray[4] * y + ray[5], 1)``. The centre of a pixel is at
            ``x = column + 0.5, y = row + 0.5``.
        light: unit vector towards the light in the camera frame.
        table_alone, table_times_albedo, albedo_alone: the factors a, b and c in the formula of the colour C.
        detail_offset, detail_per_depth: o and p in the formula of the detail d, with p in 1 / world units.
        angle_threshold, angle_softness, angle_strength, angle_colour: the colour is mixed with angle_colour where N.V
            is below angle_threshold. The mixing weight rises from 0 to angle_strength over a range of angle_softness on
            each side of the threshold.
        depth_threshold: relative jump of the inverse depth above which a line is drawn. Positive.
        normal_threshold: threshold for the cosines between the pixel's normal and the normals at the filter's taps.
            Positive. The Sobel filter draws a line where the cosines on opposite sides of the pixel differ by more than
            this value. The cross filter draws a line where the cosine at a tap is below 1 minus this value.
        line_opacity, line_colour: opacity and colour of the strongest line.
        hysteresis: where the previous image has a line, the thresholds are multiplied by ``1 - hysteresis``. At least 0
            and below 1.
        persistence: weight of a line's previous strength where the surface is at rest and the line becomes stronger. At
            least 0 and below 1.
        hatch_spacing, hatch_levels, hatch_width, hatch_colour: hatching. Layer k (0 or 1) has lines where the
            brightness sqrt(t * g) is below hatch_levels[k]. hatch_width is the width of the lines where the brightness
            is 0, as a fraction of hatch_spacing. If hatch_width is 0, there is no hatching.
        paper: the colour behind the surface.
    """

    ray: tuple[float, float, float, float, float, float]
    light: Triple
    table_alone: float = 0.0
    table_times_albedo: float = 0.0
    albedo_alone: float = 1.0
    detail_offset: float = 0.0
    detail_per_depth: float = 0.0
    angle_threshold: float = 0.0
    angle_softness: float = 0.1
    angle_strength: float = 0.0
    angle_colour: Triple = (0.0, 0.0, 0.0)
    depth_threshold: float = 0.02
    normal_threshold: float = 0.3
    line_opacity: float = 1.0
    line_colour: Triple = (0.0, 0.0, 0.0)
    hysteresis: float = 0.0
    persistence: float = 0.0
    hatch_spacing: float = 6.0
    hatch_levels: tuple[float, float] = (0.0, 0.0)
    hatch_width: float = 0.0
    hatch_colour: Triple = (0.0, 0.0, 0.0)
    paper: Triple = (0.0, 0.0, 0.0)

    def pack(self) -> NDArray[np.float32]:
        """Return all numbers in one array, in the order of the struct Numbers in csrc/stylize/stylize.h."""
        return np.concatenate([np.ravel(getattr(self, field.name)) for field in fields(self)]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class StyleParameters:
    """A style for one camera.

    Attributes:
        numbers: see :class:`Numbers`.
        table: (R, 256, 3) uint8 shade table with R from 1 to 64. Columns are tones, and rows are values of the detail.
        detail: the quantity that selects the row of the table.
        lines: the line filter.
        thickness: number of pixels between the filter's taps, from 1 to 8.
    """

    numbers: Numbers
    table: NDArray[np.uint8]
    detail: Detail = "facing"
    lines: LineFilter = "none"
    thickness: int = 1

    def pack_table(self) -> NDArray[np.uint32]:
        """Return the table as (R, 256) words with red in the lowest byte."""
        red, green, blue = (self.table[..., channel].astype(np.uint32) for channel in range(3))
        return np.ascontiguousarray(red | green << 8 | blue << 16)
