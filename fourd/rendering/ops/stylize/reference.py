"""The stylizer in NumPy, with which tests compare the kernel and the shaders: slow, but simple."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fourd.rendering.ops.stylize.parameters import (
    BACK_WEIGHT,
    FRONT_SLOPE,
    GAP,
    LEAST_STRENGTH,
    SAME_TAPS,
    TONES,
    Numbers,
    StyleParameters,
    Surface,
    speck_reach,
)

Image = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Stylized:
    """A stylized image ``rgba`` (H, W, 4) uint8, and its ``line_state`` (H, W) uint32. The line state contains the line
    strengths and the inverse depths of this image. The lines of the next image depend on it."""

    rgba: NDArray[np.uint8]
    line_state: NDArray[np.uint32]

    @property
    def lines(self) -> NDArray[np.uint8]:
        """(H, W) uint8 line strengths."""
        return (self.line_state & 255).astype(np.uint8)


def stylize_reference(
    surface: Surface, parameters: StyleParameters, line_state: NDArray[np.uint32] | None = None
) -> Stylized:
    """Compute the image of :func:`fourd.rendering.ops.stylize.op.stylize_surface`, without changing ``line_state``."""
    numbers = parameters.numbers
    closed = fill_gaps(surface)
    depth = closed.inverse_depth
    normal = np.where(closed.coverage[..., None] > 0, closed.unit_normal, 0)
    lines = find_lines(closed, parameters, line_state)
    rays = _rays(surface.size, numbers)
    facing = _clamp(-(normal * rays).sum(2) / np.sqrt((rays * rays).sum(2)))
    tone = _clamp(0.5 + 0.5 * (normal @ np.asarray(numbers.light, np.float32)))
    along = numbers.detail_offset + numbers.detail_per_depth / np.maximum(depth, 1e-20)
    details = {"facing": facing, "depth": _clamp(along), "focus": _clamp(np.abs(along))}
    shades = look_up(parameters.table, tone, details[parameters.detail])
    alpha = surface.albedo[..., 3:].astype(np.float32) / 255
    own = _clamp(surface.albedo[..., :3].astype(np.float32) / 255 / np.maximum(alpha, 1 / 255))
    colour = _clamp(shades * (numbers.table_alone + numbers.table_times_albedo * own) + numbers.albedo_alone * own)
    edge = _clamp(0.5 + (numbers.angle_threshold - facing) / (2 * numbers.angle_softness))
    colour = _mix(colour, numbers.angle_colour, numbers.angle_strength * edge)
    light = np.sqrt(_clamp(own @ np.array([0.299, 0.587, 0.114], np.float32) * tone))
    colour = _mix(colour, numbers.hatch_colour, hatching(light, numbers))
    coverage = np.where(alpha > 0, closed.coverage[..., None], 0)
    colour = np.asarray(numbers.paper, np.float32) + coverage * (colour - numbers.paper)
    shaded = _bytes(np.concatenate([colour, coverage], 2))
    state = _bytes(lines) | _seen_bits(closed, parameters.thickness)
    drawn = remove_specks(_bytes(lines), speck_reach(parameters.thickness))
    rgba = draw_lines(shaded, drawn, numbers)
    return Stylized(rgba, np.zeros_like(state) if parameters.lines == "none" else state)


def draw_lines(shaded: NDArray[np.uint8], lines: NDArray[np.uint8], numbers: Numbers) -> NDArray[np.uint8]:
    """Draw lines, given as strengths (H, W) from 0 to 255, over a shaded image (H, W, 4)."""
    line = (numbers.line_opacity * lines.astype(np.float32) / 255).astype(np.float32)
    picture = (shaded.astype(np.float32) / 255).astype(np.float32)
    colour = _mix(picture[..., :3], numbers.line_colour, line)
    return _bytes(np.concatenate([colour, np.maximum(picture[..., 3:], line[..., None])], 2))


def remove_specks(lines: NDArray[np.uint8], reach: int) -> NDArray[np.uint8]:
    """Remove very short lines (specks) from the strengths (H, W).

    Consider the squares around a pixel with sides of 2, 4, 8, ..., ``2 * reach`` pixels. The pixel's line stays if each
    of these squares has a line of at least LEAST_STRENGTH on one or more of its sides. Pixels outside the image have no
    lines. The largest square alone is not enough, because another speck can lie on its sides.
    """
    kept, half = lines, 1
    while half <= reach:
        kept = np.where(_strongest_around(lines, half) >= LEAST_STRENGTH, kept, 0).astype(np.uint8)
        half *= 2
    return kept


def _strongest_around(lines: NDArray[np.uint8], reach: int) -> NDArray[np.uint8]:
    """For each pixel, consider the square around it with a side length of ``2 * reach`` pixels. Return the strength
    (H, W) of the strongest line on the four sides of this square."""
    padded = np.pad(lines, reach)
    side = 2 * reach + 1
    columns = sliding_window_view(padded, side, axis=0).max(-1)  # (H, W + 2 * reach)
    rows = sliding_window_view(padded, side, axis=1).max(-1)  # (H + 2 * reach, W)
    sides = (columns[:, : -2 * reach], columns[:, 2 * reach :], rows[: -2 * reach], rows[2 * reach :])
    return np.maximum.reduce(sides)


def front_weight(cosine: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the factor by which a point's weight is multiplied in the mean depth and the mean normal of a visible
    surface. ``cosine`` is the cosine of the angle between the point's normal and the direction to the camera. The
    factor is small for the backs of surfaces, so they matter only where no other points are visible."""
    return BACK_WEIGHT + (1 - BACK_WEIGHT) * np.clip(0.5 + 5 * cosine, 0, 1)


def fill_gaps(surface: Surface) -> Surface:
    """Fill the gaps between points, through which farther surfaces are visible."""
    depth, normal, shift = surface.inverse_depth, surface.normal, _Shift(1)
    filled_depth, filled_normal = depth.copy(), normal.copy()
    for down, right in ((0, 1), (1, 0)):
        sides = []
        for sign in (-1, 1):
            best = np.zeros_like(depth)
            best_normal = np.zeros_like(normal)
            for step in range(sign, sign * (GAP + 1), sign):
                other = shift(depth, step * down, step * right)
                wins = other > best
                best = np.where(wins, other, best)
                best_normal = np.where(wins[..., None], shift(normal, step * down, step * right), best_normal)
            sides.append((best, best_normal))
        is_second = sides[1][0] < sides[0][0]
        gap = np.where(is_second, sides[1][0], sides[0][0])
        fills = gap > filled_depth
        filled_depth[fills] = gap[fills]
        filled_normal[fills] = np.where(is_second[..., None], sides[1][1], sides[0][1])[fills]
    return Surface(surface.albedo, filled_depth, filled_normal)


def find_lines(surface: Surface, parameters: StyleParameters, line_state: NDArray[np.uint32] | None = None) -> Image:
    """Return the line strengths (H, W), in [0, 1], of a surface whose gaps are filled."""
    scale = np.ones(surface.size, np.float32)
    if parameters.lines == "none":
        return np.zeros(surface.size, np.float32)
    kept = _kept_lines(surface, parameters)
    if line_state is None:
        return kept * _fresh_lines(surface, parameters, scale)
    before = (line_state & 255).astype(np.float32) / 255
    scale[line_state & 255 >= 128] = 1 - parameters.numbers.hysteresis
    lines = kept * _fresh_lines(surface, parameters, scale)
    seen = _seen_bits(surface, parameters.thickness).view(np.float32)
    old = (line_state & np.uint32(0xFFFF0000)).view(np.float32)
    is_faint = (np.abs(seen - old) <= np.float32(SAME_TAPS) * seen) & (lines > before)
    return np.where(is_faint, lines + np.float32(parameters.numbers.persistence) * (before - lines), lines)


def _seen_bits(surface: Surface, thickness: int) -> NDArray[np.uint32]:
    """Return the bits (H, W) uint32 of a float32 number: the sum of the inverse depths at the nine taps of the line
    filter. The lower 16 bits are set to 0."""
    depth, shift = surface.inverse_depth, _Shift(thickness)
    corners = (shift(depth, -1, -1) + shift(depth, -1, 1)) + (shift(depth, 1, -1) + shift(depth, 1, 1))
    arms = (shift(depth, -1, 0) + shift(depth, 1, 0)) + (shift(depth, 0, -1) + shift(depth, 0, 1))
    return ((corners + arms) + depth).astype(np.float32).view(np.uint32) & np.uint32(0xFFFF0000)


def _fresh_lines(surface: Surface, parameters: StyleParameters, scale: Image) -> Image:
    """Return the strengths (H, W) of the lines that the line filter finds on ``surface``. They do not yet fade in over
    successive images. The filter's thresholds are multiplied by ``scale`` (H, W)."""
    numbers, depth, coverage = parameters.numbers, surface.inverse_depth, surface.coverage
    normal = surface.unit_normal * coverage[..., None]
    shift = _Shift(parameters.thickness)
    taps = {
        (down, right): (shift(depth, down, right), (shift(normal, down, right) * normal).sum(2))
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
    }
    if parameters.lines == "sobel":
        most = np.maximum(np.max([tap[0] for tap in taps.values()], axis=0), 1e-20)
        jump = _sobel({at: tap[0] for at, tap in taps.items()}) / most
        turn = _sobel({at: tap[1] for at, tap in taps.items()})
        return np.maximum(
            _ramp(jump, numbers.depth_threshold * scale), _ramp(turn, numbers.normal_threshold * scale)
        ).astype(np.float32)
    arms = ((-1, 0), (0, -1), (0, 1), (1, 0))
    most = np.maximum(np.max([taps[at][0] for at in ((0, 0), *arms)], axis=0), 1e-20)
    bends = [np.abs(taps[a][0] + taps[b][0] - 2 * depth) for a, b in ((arms[0], arms[3]), (arms[1], arms[2]))]
    for axis, bend in enumerate(bends):
        # Pixels with taps outside the image are excluded. Such taps repeat the border, which would look like a bend of
        # the surface.
        bend.swapaxes(0, axis)[: parameters.thickness] = 0
        bend.swapaxes(0, axis)[max(bend.shape[axis] - parameters.thickness, 0) :] = 0
    flat = 1 - _ramp((bends[0] + bends[1]) / (2 * most), numbers.depth_threshold * scale)
    for at in arms:
        flat = flat * (1 - _ramp(coverage - taps[at][1], numbers.normal_threshold * scale))
    return (1 - flat).astype(np.float32)


def _kept_lines(surface: Surface, parameters: StyleParameters) -> Image:
    """Return the factors (H, W), in [0, 1], that remove lines near the backs of surfaces. They multiply the line
    strengths. A factor is 1 if no tap of the line filter shows the back of a surface, or if any tap shows no surface.
    Otherwise, it falls to 0 as the surface turns away from the camera; see FRONT_SLOPE."""
    coverage, shift = surface.coverage, _Shift(parameters.thickness)
    normal, rays = surface.unit_normal * coverage[..., None], _rays(surface.size, parameters.numbers)
    square = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
    at = square if parameters.lines == "sobel" else [tap for tap in square if 0 in tap]
    away = np.max([(shift(normal, *tap) * rays).sum(2) for tap in at], axis=0)
    least_coverage = np.min([shift(coverage, *tap) for tap in at], axis=0)
    return np.maximum(_clamp(1 - np.float32(FRONT_SLOPE) * away), 1 - least_coverage).astype(np.float32)


def look_up(table: NDArray[np.uint8], tone: Image, detail: Image) -> Image:
    """Look up colours in a shade table (R, 256, 3), at the nearest column and interpolated between two rows."""
    column = (tone * (TONES - 1) + 0.5).astype(int)
    row = detail * (len(table) - 1)
    first = np.minimum(row.astype(int), max(len(table) - 2, 0))
    second = np.minimum(first + 1, len(table) - 1)
    colours = table.astype(np.float32) / 255
    return _mix(colours[first, column], colours[second, column], row - first)


def hatching(light: Image, numbers: Numbers) -> Image:
    """Return the opacity (H, W), in [0, 1], of the hatching lines. ``light`` (H, W) is sqrt(t * g) of
    :mod:`fourd.rendering.ops.stylize.parameters`."""
    height, width = light.shape
    y, x = np.mgrid[:height, :width].astype(np.float32) + np.float32(0.5)
    ink = np.zeros(light.shape, np.float32)
    for position, level in zip((x + 0.5 * y, 16384 + x - 0.7 * y), numbers.hatch_levels, strict=True):
        part = position / numbers.hatch_spacing
        part = part - np.trunc(part)
        distance = 1 - np.abs(2 * part - 1)
        wide = numbers.hatch_width * _clamp((level - light) / max(level, 1e-6))
        share = _clamp((wide - distance) * numbers.hatch_spacing * 0.5 + 0.5)
        ink = np.maximum(ink, np.where(wide > 0, share, 0))
    return ink


@dataclass(frozen=True)
class _Shift:
    """Shifts an image by multiples of ``thickness`` pixels. Pixels outside the image repeat the image's border."""

    thickness: int

    def __call__(self, image: NDArray[Any], down: int, right: int) -> NDArray[Any]:
        height, width = image.shape[:2]
        rows = np.clip(np.arange(height) + down * self.thickness, 0, height - 1)
        columns = np.clip(np.arange(width) + right * self.thickness, 0, width - 1)
        return image[rows[:, None], columns]


def _sobel(taps: dict[tuple[int, int], Image]) -> Image:
    """Return the magnitude of the Sobel gradient, scaled so that a step of height h gives h."""
    columns = {right: taps[-1, right] + taps[1, right] + 2 * taps[0, right] for right in (-1, 1)}
    rows = {down: taps[down, -1] + taps[down, 1] + 2 * taps[down, 0] for down in (-1, 1)}
    return np.sqrt((columns[1] - columns[-1]) ** 2 + (rows[1] - rows[-1]) ** 2) / 4


def _rays(size: tuple[int, int], numbers: Numbers) -> Image:
    height, width = size
    y, x = np.mgrid[:height, :width].astype(np.float32) + np.float32(0.5)
    ray = np.asarray(numbers.ray, np.float32)
    across, along = ray[0] * x + ray[1] * y + ray[2], ray[3] * x + ray[4] * y + ray[5]
    return np.stack([across, along, np.ones_like(x)], 2)


def _ramp(value: Image, threshold: Image) -> Image:
    """Return a linear ramp from 0 at the threshold to 1 at 1.5 times the threshold."""
    return _clamp(2 * (value / threshold - 1))


def _mix(a: Image, b: object, share: Image) -> Image:
    return (a + share[..., None] * (np.asarray(b, np.float32) - a)).astype(np.float32)


def _clamp(value: NDArray[np.floating]) -> Image:
    return np.clip(value, 0, 1).astype(np.float32)


def _bytes(value: Image) -> NDArray[np.uint8]:
    return (_clamp(value) * 255 + 0.5).astype(np.uint8)
