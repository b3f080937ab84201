"""Pictures of another size than their calibration's: how one became the other, judged by the pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.calibration.matching import Matches
from fourd.calibration.residuals import Pair, Residuals, residuals_of
from fourd.cameras import Camera

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

BLACK = 40
"""A row or column is border when 95 in 100 of its pixels are darker than this, of 255."""
CONTENT_ROWS = 4
NEAR_PX = 0.75
"""By which a border may differ from the one that a hypothesis makes."""
WORST_PX = 3.0
LEAD = 1.5
"""The second best hypothesis must be this many times as far from the pictures as the best, for evidence to be clear."""


@dataclass(frozen=True)
class Borders:
    """Widths of the black borders of a picture, in pixels and fractions of them."""

    left: float
    top: float
    right: float
    bottom: float

    def difference(self, other: Borders) -> float:
        """The greatest difference on any side."""
        pairs = ((self.left, other.left), (self.top, other.top), (self.right, other.right), (self.bottom, other.bottom))
        return max(abs(mine - its) for mine, its in pairs)


@dataclass(frozen=True, eq=False)
class SizeChoice:
    """What became of pictures whose size is not their calibration's.

    Attributes:
        name: the best hypothesis.
        lenses: all cameras for the pictures as they are, under that hypothesis.
        residuals: of all pairs of cameras, by hypothesis.
        means_px: mean of the medians of the pairs with a resized camera, by hypothesis; None without such a pair.
        borders_px: greatest difference of the measured borders from those that a hypothesis makes; None if unmeasured.
        is_clear: whether the evidence decides; else a person should look.
        why: the evidence in one line.
    """

    name: str
    lenses: tuple[Camera, ...]
    residuals: dict[str, Residuals]
    means_px: dict[str, float | None]
    borders_px: dict[str, float | None]
    is_clear: bool
    why: str


def size_hypotheses(lens: Camera, width: int, height: int) -> dict[str, Camera]:
    """The camera of pictures of ``width`` x ``height``, by the way they were made from those of ``lens``.

    Names: ``unchanged`` alone for equal sizes, else
    - ``stretched``: each axis scaled by itself; ``scaled`` where both have one scale, to half a pixel;
    - ``letterboxed``: one scale so that all fits, black borders on two sides, equally wide;
    - ``filled``: one scale so that no border stays, the rest cut off equally on two sides;
    - ``cropped left``, ``cropped right`` (``top``, ``bottom``): not scaled, what is missing was cut off
      that side; ``cropped centre``: equally off both sides; only where no side is longer than before.

    Distortion is kept: it is in units of the focal length.
    """
    if (width, height) == (lens.width, lens.height):
        return {"unchanged": lens}
    x, y = width / lens.width, height / lens.height
    if abs(lens.width * y - width) <= 0.5 or abs(lens.height * x - height) <= 0.5:
        found = {"scaled": lens.resize(width, height)}
    else:
        found = {"stretched": lens.resize(width, height), "letterboxed": _fitted(lens, width, height, min(x, y))}
        if max(x, y) != 1:
            found["filled"] = _fitted(lens, width, height, max(x, y))
    if width > lens.width or height > lens.height:
        return found
    missing_x, missing_y = lens.width - width, lens.height - height
    found["cropped centre"] = _fitted(lens, width, height, 1.0)
    if not missing_y:
        found["cropped left"] = lens.crop(missing_x, 0, width, height)
        found["cropped right"] = lens.crop(0, 0, width, height)
    if not missing_x:
        found["cropped top"] = lens.crop(0, missing_y, width, height)
        found["cropped bottom"] = lens.crop(0, 0, width, height)
    return found


def _fitted(lens: Camera, width: int, height: int, scale: float) -> Camera:
    """Scaled about the picture's middle, which stays the middle."""
    shift = (width - scale * lens.width) / 2, (height - scale * lens.height) / 2
    change = np.array([[scale, 0, shift[0]], [0, scale, shift[1]], [0, 0, 1]])
    return replace(lens, intrinsics=change @ lens.intrinsics, width=width, height=height)


def black_borders(pictures: Sequence[Picture]) -> Borders:
    """Black borders of one camera's pictures (H, W, 3), uint8, which must be as recorded: not undistorted.

    Several frames are better than one. A border that ends within a pixel leaves that pixel a
    mixture; its share, by the brightness of the next rows, is counted. Where the scene itself is
    dark along a side, the border cannot be told and comes out 0 or too wide.
    """
    grey = np.mean([picture.mean(axis=2) for picture in pictures], axis=0)
    sides = (grey.T, grey, grey.T[::-1], grey[::-1])
    left, top, right, bottom = (_border(rows) for rows in sides)
    return Borders(left, top, right, bottom)


def _border(rows: Array) -> float:
    """Width of the border before the first row, to a fraction."""
    bright = np.percentile(rows[: len(rows) // 4], 95, axis=1) >= BLACK
    if bright[0] or not bright.any():
        return 0.0
    first = int(bright.argmax())
    level = rows[: first + 2 + CONTENT_ROWS].mean(axis=1)
    floor = float(level[:first].min())
    content = float(level[first + 2 :].mean())
    if content - floor < 1:
        return 0.0
    share = np.clip((level[: first + 2] - floor) / (content - floor), 0, 1)
    # The codec's ringing inside the border is not content.
    share[: max(first - 1, 0)] = 0
    return float((1 - share).sum())


def pick_size(
    matches: Mapping[Pair, Matches],
    lenses: Sequence[Camera],
    sizes: Sequence[tuple[int, int]],
    borders: Mapping[int, Borders] | None = None,
) -> SizeChoice:
    """Find how pictures came to a size that their calibration has not; all such are taken to be made one way.

    Args:
        matches: of pairs of pictures, in their own pixels (of several frames, joined).
        lenses: the calibration, one camera a picture.
        sizes: (width, height) of the pictures.
        borders: by index of the camera, of those whose size differs.

    Returns:
        SizeChoice. Black borders decide where the hypotheses make different ones; among those that
        fit them the least epipolar residual does. The evidence is clear when borders of at least 2
        pixels are met by one hypothesis alone, or when the best hypothesis agrees with the
        pictures to 3 pixels and any other that the borders allow is 1.5 times as far from them.

    Raises:
        ValueError: when all sizes are the calibration's, or no way would make all of them.
    """
    options = [size_hypotheses(lens, *size) for lens, size in zip(lenses, sizes, strict=True)]
    resized = [index for index, option in enumerate(options) if "unchanged" not in option]
    names = [name for name in options[resized[0]] if all(name in options[i] for i in resized)] if resized else []
    if not names:
        raise ValueError("sizes: expected some that differ from the calibration's in one way, got none")
    cameras = {name: tuple(option.get(name, lenses[i]) for i, option in enumerate(options)) for name in names}
    residuals = {name: residuals_of(matches, cameras[name]) for name in names}
    means = {name: _mean(found, resized) for name, found in residuals.items()}
    misses = {name: _border_miss(name, cameras[name], lenses, borders) for name in names}
    allowed = [name for name in names if (miss := misses[name]) is None or miss <= NEAR_PX] or names
    best = min(allowed, key=lambda name: (_or_infinity(means[name]), names.index(name)))
    is_wide = bool(borders) and any(max(b.left, b.top, b.right, b.bottom) >= 2 for b in (borders or {}).values())
    by_borders = is_wide and len(allowed) == 1
    others = [_or_infinity(means[name]) for name in allowed if name != best]
    mean = means[best]
    by_residuals = mean is not None and mean <= WORST_PX and all(other >= LEAD * mean for other in others)
    contradicted = mean is not None and min(map(_or_infinity, means.values())) * LEAD < mean <= WORST_PX
    is_clear = (by_borders and not contradicted) or (by_residuals and len(names) > 1)
    return SizeChoice(best, cameras[best], residuals, means, misses, is_clear, _why(means, misses))


def _mean(found: Residuals, resized: Sequence[int]) -> float | None:
    values = [value for pair, value in found.pairs.items() if set(pair) & set(resized)]
    return float(np.mean(values)) if values else None


def _border_miss(
    name: str, cameras: Sequence[Camera], lenses: Sequence[Camera], borders: Mapping[int, Borders] | None
) -> float | None:
    if not borders:
        return None
    return max(found.difference(_made(name, cameras[index], lenses[index])) for index, found in borders.items())


def _made(name: str, camera: Camera, lens: Camera) -> Borders:
    """The borders that a hypothesis makes."""
    if name != "letterboxed":
        return Borders(0, 0, 0, 0)
    scale = min(camera.width / lens.width, camera.height / lens.height)
    x, y = (camera.width - scale * lens.width) / 2, (camera.height - scale * lens.height) / 2
    return Borders(x, y, x, y)


def _why(means: Mapping[str, float | None], misses: Mapping[str, float | None]) -> str:
    parts = []
    for name, mean in means.items():
        residual = "no matches" if mean is None else f"{mean:.2f} px off"
        miss = misses[name]
        parts.append(f"{name}: {residual}" + ("" if miss is None else f", borders {miss:.1f} px off"))
    return "; ".join(parts)


def _or_infinity(value: float | None) -> float:
    return float("inf") if value is None else value
