"""Reads masks of any program as mattes, in which 255 is the object.

What the values of masks mean is decided for all masks of a camera together, because one mask may be empty or contain
only one of several labels.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fourd.base.errors import UserError
from fourd.recording.capture.decoding import ALPHA_MODES, decode_image
from fourd.recording.capture.layout import camera_folders, find_pictures, sample_indices

Picture = NDArray[np.uint8]
Values = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]

SAMPLES = 8
"""Number of masks per camera that are examined."""
MAX_LABELS = 32
"""Maximum number of different values in masks that contain labels instead of opacities."""
LOW_SHARE = 0.25
"""Values below this fraction of white are low. If most values of few are low, they are labels."""
MIN_COLOUR = 24
"""Difference of the channels of a pixel above which it is coloured. JPEG compression colours grey pixels a little."""
MIN_JPEG_COLOUR = 64

MIN_COLOURED_SHARE = 0.01
"""Fraction of the pixels of an object that must be coloured in masks whose colours are labels."""
MIN_LABEL_SHARE = 0.002
"""Fraction of the pixels of an image above which labels are distinguished with certainty from the edge of an object."""

Meaning = Literal["grey", "labels", "alpha", "palette", "colours"]
NOTES: dict[Meaning, str] = {
    "labels": "all values above 0 are taken as the object (largest value: {largest})",
    "alpha": "the alpha channel is taken as the mask",
    "palette": "colours of a palette are labels: the first is the background, all others are the object",
    "colours": "colours are labels: black is the background, all others are the object",
}


@dataclass(frozen=True)
class MaskRule:
    """The meaning of the values of one camera's masks.

    Attributes:
        meaning: "grey" values are opacities, of "labels" all but 0 are the object, and "alpha" is the alpha channel. In
            "palette", the first entry is the background; in "colours", black is.
        white: the value of opaque pixels in "grey": 255, 65535, or 1 for floating-point values.
        largest: the largest value in the examined masks.
        is_sure: False if labels cover so little that they may also be the faint edge of an object.
    """

    meaning: Meaning = "grey"
    white: float = 255
    largest: float = 255
    is_sure: bool = True

    def note(self) -> str | None:
        """Return what the user should know about the meaning, or None for ordinary masks."""
        text = NOTES.get(self.meaning)
        return None if text is None else text.format(largest=f"{self.largest:g}")


class MaskFolder:
    """Masks CAM/FRAME.png of all cameras in one folder.

    The masks of a camera are examined when the first of them is decoded.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rules: dict[str, MaskRule] = {}

    def decode(self, path: Path) -> Picture:
        """Decode a mask in the folder of a camera to a matte (H, W) uint8, 255 = object.

        Raises:
            UserError: if the file is damaged, or the meaning of the camera's masks cannot be decided.
        """
        return decode_mask(path, self.rule(path.parent.name))

    def rule(self, camera: str) -> MaskRule:
        """Return the meaning of a camera's masks. If they are all empty or too dark to decide, the masks of the other
        cameras decide.

        Raises:
            UserError: if an examined file is damaged, or the masks of no camera decide.
        """
        if camera not in self._rules:
            own = self._examine(camera)
            if not (isinstance(own, MaskRule) and own.is_sure):
                own = self._by_others(camera, own)
            self._rules[camera] = own
        return self._rules[camera]

    def notes(self) -> list[str]:
        """Return one line for each unusual meaning of masks.

        Raises:
            UserError: for the same reasons as :meth:`rule`.
        """
        groups: dict[str, list[str]] = {}
        cameras = [name for name in camera_folders(self.folder) if self._files(name)]
        for name in cameras:
            note = self.rule(name).note()
            if note is not None:
                groups.setdefault(note, []).append(name)
        return [
            f"{self.folder}: {'' if len(names) == len(cameras) else ', '.join(names) + ': '}{note}"
            for note, names in groups.items()
        ]

    def _files(self, camera: str) -> list[Path]:
        return [self.folder / camera / file for file in find_pictures(self.folder / camera).values()]

    def _examine(self, camera: str) -> MaskRule | UserError | None:
        return examine_masks(self._files(camera))

    def _by_others(self, camera: str, own: MaskRule | UserError | None) -> MaskRule:
        """Decide for a camera whose own masks do not decide."""
        for name in camera_folders(self.folder):
            found = self._rules.get(name) or (self._examine(name) if name != camera else None)
            if isinstance(found, MaskRule) and found.is_sure:
                return found
        if isinstance(own, UserError):
            raise own
        return own or MaskRule()


def examine_masks(files: Sequence[Path]) -> MaskRule | UserError | None:
    """Decide the meaning of a camera's masks from some of them.

    Returns:
        The meaning, None if all examined masks are empty, or an error if their values are neither opacities nor labels.

    Raises:
        UserError: if a file is damaged, or coloured masks have no black background.
    """
    found = _Values()
    for index in _middle_first(len(files)):
        found.add(decode_image(files[index]))
        if found.is_decided:
            break
    return found.decide(files[0].parent if files else Path())


def decode_mask(path: Path, rule: MaskRule) -> Picture:
    """Decode a mask by a rule to a matte (H, W) uint8, 255 = object. Raises UserError if the file is damaged."""
    image = decode_image(path)
    if rule.meaning == "alpha" and _has_alpha(image):
        return np.array(image.convert("RGBA").getchannel("A"))
    if rule.meaning == "palette" and image.mode == "P":
        return _white_where(_foreground_of_palette(image))
    if rule.meaning in ("colours", "palette") and image.mode not in ("L", "1", "I;16"):
        limit = MIN_JPEG_COLOUR if _is_jpeg(image) else 0
        return _white_where(np.asarray(image.convert("RGB")).max(axis=2) > limit)
    values = _grey_values(image)
    if rule.meaning in ("labels", "colours", "palette"):
        return _white_where(values > 0)
    if rule.white == 255 and values.dtype == np.uint8:
        return values.astype(np.uint8, copy=False)
    return np.clip(np.rint(values * (255 / rule.white)), 0, 255).astype(np.uint8)


class _Values:
    """Values of the masks that have been examined."""

    def __init__(self) -> None:
        self.counts: Counter[float] = Counter()
        self.bits = 8
        self.is_jpeg = False
        self.has_alpha = self.has_palette = self.has_colours = self.has_black = False

    def add(self, image: Image.Image) -> None:
        self.is_jpeg |= _is_jpeg(image)
        if _has_alpha(image):
            self.has_alpha |= bool(np.asarray(image.convert("RGBA").getchannel("A")).min() < 255)
        if image.mode not in ("L", "1", "LA", "I", "F") and not image.mode.startswith("I;16"):
            rgb = np.asarray(image.convert("RGB"))
            largest, difference = rgb.max(axis=2), rgb.max(axis=2) - rgb.min(axis=2)
            coloured, bright = np.count_nonzero(difference > MIN_COLOUR), np.count_nonzero(largest > MIN_COLOUR)
            self.has_palette |= image.mode == "P" and bool(difference.any())
            self.has_colours |= image.mode != "P" and bool(coloured > MIN_COLOURED_SHARE * bright)
            self.has_black |= bool((largest <= (MIN_JPEG_COLOUR if self.is_jpeg else 0)).any())
        values = _grey_values(image)
        self.bits = max(self.bits, 8 * values.dtype.itemsize)
        for value, count in zip(*np.unique(values, return_counts=True), strict=True):
            self.counts[float(value)] += int(count)

    @property
    def is_decided(self) -> bool:
        """Whether further masks of the camera would not change the decision."""
        if self.has_alpha or self.has_palette:
            return True
        return not self.has_colours and max(self.counts) == 255 and not self._are_labels(255)

    def decide(self, folder: Path) -> MaskRule | UserError | None:
        largest = max(self.counts, default=0.0)
        if self.has_alpha:
            return MaskRule("alpha")
        if self.has_palette:
            return MaskRule("palette")
        if self.has_colours:
            if not self.has_black:
                raise UserError(
                    f"{folder}: expected masks with a black background, got coloured masks without black; export white "
                    "masks on black"
                )
            return MaskRule("colours")
        if largest <= 0:
            return None
        white = 255.0 if largest <= 255 else 65535.0
        if self.bits == 32 and largest <= 1:
            white = 1.0
        if self._are_labels(white):
            covered = sum(count for value, count in self.counts.items() if value > 0) / self.counts.total()
            return MaskRule("labels", white, largest, largest <= 1 or covered >= MIN_LABEL_SHARE)
        if largest < white / 2:
            return UserError(
                f"{folder}: expected masks whose white is {white:g}, got values up to {largest:g}; export masks of 0 "
                f"and {white:g}"
            )
        return MaskRule("grey", white, largest)

    def _are_labels(self, white: float) -> bool:
        """Whether the values are labels: a single value, or few values, most of which are far from white."""
        objects = {value: count for value, count in self.counts.items() if value > 0}
        if self.is_jpeg or not objects or len(objects) > MAX_LABELS or set(objects) == {white}:
            return False
        low = sum(count for value, count in objects.items() if value < LOW_SHARE * white)
        return len(objects) == 1 or max(objects) < white / 2 or low > sum(objects.values()) / 2


def _middle_first(count: int) -> Iterable[int]:
    """Return indices of evenly spaced masks. The first and last masks are examined last, because they are often
    empty."""
    chosen = sample_indices(count, SAMPLES) if count else []
    return sorted(chosen, key=lambda index: abs(index - (count - 1) / 2))


def _has_alpha(image: Image.Image) -> bool:
    return image.mode in ALPHA_MODES or "transparency" in image.info


def _is_jpeg(image: Image.Image) -> bool:
    return getattr(image, "format", None) in ("JPEG", "MPO")


def _foreground_of_palette(image: Image.Image) -> NDArray[np.bool_]:
    """Return which pixels of a palette image are not background. The background is the first entry, or black if the
    first entry has a colour and another one is black."""
    palette = np.reshape(np.array(image.getpalette("RGB") or [0, 0, 0], np.uint8), (-1, 3))
    index = np.asarray(image)
    is_black = palette.max(axis=1) == 0
    if len(palette) and not is_black[0] and is_black[np.unique(index[index < len(palette)])].any():
        return np.asarray(image.convert("RGB")).max(axis=2) > 0
    return index > 0


def _grey_values(image: Image.Image) -> Values:
    """Return the grey values (H, W) of an image: uint8, uint16, or 32-bit numbers."""
    if image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.uint16)
    if image.mode in ("I", "F"):
        return np.asarray(np.round(np.nan_to_num(np.asarray(image, np.float32)), 3), np.float32)
    return np.asarray(image.convert("L"))


def _white_where(is_object: NDArray[np.bool_]) -> Picture:
    return np.where(is_object, np.uint8(255), np.uint8(0))
