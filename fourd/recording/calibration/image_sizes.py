"""Hypotheses of how images were resized after the calibration, and choice of the hypothesis that fits the images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.calibration.matching import Matches
from fourd.recording.calibration.residuals import Pair, Residuals, compute_residuals

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

BLACK_LEVEL = 40
"""Brightness limit (0 to 255) of black borders. In a border row or column, 95% of the pixels are below this limit."""
CONTENT_ROWS = 4
MAX_BORDER_ERROR_PX = 0.75
"""Maximum difference in pixels between the measured width of a black border and the width predicted by a hypothesis."""
MAX_GOOD_PX = 3.0
MIN_LEAD = 1.5
"""The evidence for the hypothesis with the smallest residual is clear if the second smallest residual is at least this
multiple of the smallest one."""


@dataclass(frozen=True)
class Borders:
    """Widths of an image's black borders in pixels; a width may be fractional."""

    left: float
    top: float
    right: float
    bottom: float

    def max_difference(self, other: Borders) -> float:
        """Compare the border widths of two images on each of the four sides. Return the largest difference in
        pixels."""
        pairs = ((self.left, other.left), (self.top, other.top), (self.right, other.right), (self.bottom, other.bottom))
        return max(abs(a - b) for a, b in pairs)


@dataclass(frozen=True, eq=False)
class SizeChoice:
    """The best hypothesis of how images were resized, and the evidence.

    Attributes:
        name: the best hypothesis.
        cameras: the cameras of all images under the best hypothesis.
        residuals: epipolar residuals of each hypothesis.
        means_px: for each hypothesis, the mean residual of the camera pairs in which the images of at least one camera
            were resized. The residual of a pair is the median over its matches. The mean is None if no such pair has
            enough matches.
        borders_px: for each hypothesis, the largest difference in pixels between measured and predicted borders, or
            None if the borders were not measured.
        is_clear: whether the evidence is sufficient to choose a hypothesis without asking the user.
        why: the evidence in one line.
    """

    name: str
    cameras: tuple[Camera, ...]
    residuals: dict[str, Residuals]
    means_px: dict[str, float | None]
    borders_px: dict[str, float | None]
    is_clear: bool
    why: str


def size_hypotheses(camera: Camera, width: int, height: int) -> dict[str, Camera]:
    """Return hypotheses of how the images of one camera were resized to ``width`` x ``height`` pixels. The result
    maps the name of each hypothesis to the camera of the resized images.

    ``camera`` is the camera of the images before resizing.

    If the new size equals the camera's size, the only hypothesis is ``unchanged``. Otherwise the names are:
    - ``scaled``: width and height are scaled by the same factor. It replaces the next three hypotheses if one factor
      gives both the new width and the new height, to within half a pixel;
    - ``stretched``: width and height are scaled by different factors;
    - ``letterboxed``: the whole image is scaled to fit, with equal black borders on two sides;
    - ``filled``: the image is scaled until no border remains, then cropped equally on two opposite sides;
    - ``cropped left``, ``cropped right``, ``cropped top`` and ``cropped bottom``: the image is cropped on the named
      side and not scaled;
    - ``cropped centre``: the image is cropped equally on opposite sides and not scaled.

    The cropped hypotheses are omitted if the new image is wider or higher than the old image. All hypotheses keep the
    distortion coefficients, because these apply to coordinates divided by the focal length.
    """
    if (width, height) == (camera.width, camera.height):
        return {"unchanged": camera}
    x, y = width / camera.width, height / camera.height
    if abs(camera.width * y - width) <= 0.5 or abs(camera.height * x - height) <= 0.5:
        found = {"scaled": camera.resize(width, height)}
    else:
        found = {
            "stretched": camera.resize(width, height),
            "letterboxed": _scale_about_centre(camera, width, height, min(x, y)),
        }
        if max(x, y) != 1:
            found["filled"] = _scale_about_centre(camera, width, height, max(x, y))
    if width > camera.width or height > camera.height:
        return found
    missing_x, missing_y = camera.width - width, camera.height - height
    found["cropped centre"] = _scale_about_centre(camera, width, height, 1.0)
    if not missing_y:
        found["cropped left"] = camera.crop(missing_x, 0, width, height)
        found["cropped right"] = camera.crop(0, 0, width, height)
    if not missing_x:
        found["cropped top"] = camera.crop(0, missing_y, width, height)
        found["cropped bottom"] = camera.crop(0, 0, width, height)
    return found


def _scale_about_centre(camera: Camera, width: int, height: int, scale: float) -> Camera:
    shift = (width - scale * camera.width) / 2, (height - scale * camera.height) / 2
    change = np.array([[scale, 0, shift[0]], [0, scale, shift[1]], [0, 0, 1]])
    return replace(camera, intrinsics=change @ camera.intrinsics, width=width, height=height)


def measure_black_borders(pictures: Sequence[Picture]) -> Borders:
    """Measure the black borders of one camera's distorted images (H, W, 3) uint8.

    The mean over several frames gives more exact borders than one frame. If a border ends inside a pixel, the black
    fraction of that pixel is estimated by comparing its brightness with the image content beside it. If the scene is
    dark along a side, the measured border is 0 or too wide.
    """
    grey = np.mean([picture.mean(axis=2) for picture in pictures], axis=0)
    sides = (grey.T, grey, grey.T[::-1], grey[::-1])
    left, top, right, bottom = (_border_width(rows) for rows in sides)
    return Borders(left, top, right, bottom)


def _border_width(rows: Array) -> float:
    """Return the (fractional) width, in pixels, of the black border before the first row of content."""
    bright = np.percentile(rows[: len(rows) // 4], 95, axis=1) >= BLACK_LEVEL
    if bright[0] or not bright.any():
        return 0.0
    first = int(bright.argmax())
    level = rows[: first + 2 + CONTENT_ROWS].mean(axis=1)
    floor = float(level[:first].min())
    content = float(level[first + 2 :].mean())
    if content - floor < 1:
        return 0.0
    share = np.clip((level[: first + 2] - floor) / (content - floor), 0, 1)
    # Of the black rows, only the last one can be partly covered by the image. If the rows before it are not quite
    # black, this is a ringing artefact of the codec, so they count as black.
    share[: max(first - 1, 0)] = 0
    return float((1 - share).sum())


def choose_size(
    matches: Mapping[Pair, Matches],
    cameras: Sequence[Camera],
    sizes: Sequence[tuple[int, int]],
    borders: Mapping[int, Borders] | None = None,
) -> SizeChoice:
    """Find how images were resized, assuming one method for all resized images.

    Each hypothesis is one method of resizing, see :func:`size_hypotheses`. A hypothesis is excluded if a black border
    that it predicts differs by more than :data:`MAX_BORDER_ERROR_PX` from the measured border. If no hypothesis fits
    the measured borders, none is excluded. The function chooses the remaining hypothesis with the smallest epipolar
    residual r. The evidence is clear if either of these conditions holds:
    - there are at least two hypotheses, including the excluded ones, r is at most 3 pixels, and each remaining
      hypothesis, except the chosen one, has a residual of at least 1.5 * r;
    - only the chosen hypothesis remains, and an image has a black border of at least 2 pixels.
    The evidence is never clear if residuals and borders contradict each other, that is, if r is at most 3 pixels but an
    excluded hypothesis has a residual below r / 1.5.

    Args:
        matches: matches of each camera pair in pixels of the distorted images; the matches of all frames are
            concatenated.
        cameras: the calibration, one camera per image.
        sizes: (width, height) of each image in pixels.
        borders: measured borders of the resized images by camera index, or None if no borders were measured.

    Raises:
        ValueError: if no image is resized, or no hypothesis explains all sizes.
    """
    options = [size_hypotheses(camera, *size) for camera, size in zip(cameras, sizes, strict=True)]
    resized = [index for index, option in enumerate(options) if "unchanged" not in option]
    names = [name for name in options[resized[0]] if all(name in options[i] for i in resized)] if resized else []
    if not names:
        raise ValueError("sizes: expected images that were all resized by the same method, got none")
    by_name = {name: tuple(option.get(name, cameras[i]) for i, option in enumerate(options)) for name in names}
    residuals = {name: compute_residuals(matches, by_name[name]) for name in names}
    means = {name: _mean_residual(found, resized) for name, found in residuals.items()}
    border_errors = {name: _border_error(name, by_name[name], cameras, borders) for name in names}
    allowed = [name for name in names if (error := border_errors[name]) is None or error <= MAX_BORDER_ERROR_PX]
    allowed = allowed or names
    best = min(allowed, key=lambda name: (_or_infinity(means[name]), names.index(name)))
    is_clear = _is_clear(best, allowed, means, borders)
    return SizeChoice(best, by_name[best], residuals, means, border_errors, is_clear, _evidence(means, border_errors))


def _is_clear(
    best: str, allowed: Sequence[str], means: Mapping[str, float | None], borders: Mapping[int, Borders] | None
) -> bool:
    is_wide = any(max(b.left, b.top, b.right, b.bottom) >= 2 for b in (borders or {}).values())
    by_borders = is_wide and len(allowed) == 1
    others = [_or_infinity(means[name]) for name in allowed if name != best]
    mean = means[best]
    by_residuals = mean is not None and mean <= MAX_GOOD_PX and all(other >= MIN_LEAD * mean for other in others)
    contradicted = mean is not None and min(map(_or_infinity, means.values())) * MIN_LEAD < mean <= MAX_GOOD_PX
    return not contradicted and (by_borders or (by_residuals and len(means) > 1))


def _mean_residual(found: Residuals, resized: Sequence[int]) -> float | None:
    values = [value for pair, value in found.pairs.items() if set(pair) & set(resized)]
    return float(np.mean(values)) if values else None


def _border_error(
    name: str, resized: Sequence[Camera], cameras: Sequence[Camera], borders: Mapping[int, Borders] | None
) -> float | None:
    if not borders:
        return None
    return max(
        found.max_difference(_predicted_borders(name, resized[index], cameras[index]))
        for index, found in borders.items()
    )


def _predicted_borders(name: str, resized: Camera, camera: Camera) -> Borders:
    if name != "letterboxed":
        return Borders(0, 0, 0, 0)
    scale = min(resized.width / camera.width, resized.height / camera.height)
    x, y = (resized.width - scale * camera.width) / 2, (resized.height - scale * camera.height) / 2
    return Borders(x, y, x, y)


def _evidence(means: Mapping[str, float | None], border_errors: Mapping[str, float | None]) -> str:
    parts = []
    for name, mean in means.items():
        residual = "no matches" if mean is None else f"{mean:.2f} px off"
        error = border_errors[name]
        parts.append(f"{name}: {residual}" + ("" if error is None else f", borders {error:.1f} px off"))
    return "; ".join(parts)


def _or_infinity(value: float | None) -> float:
    return float("inf") if value is None else value
