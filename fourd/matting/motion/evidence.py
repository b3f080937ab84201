"""Log-odds that a pixel shows the subject, from its own camera and from the agreement with the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.matting.motion.agreement import NOWHERE, Cells
from fourd.matting.motion.background_model import Background
from fourd.matting.motion.channels import channel_max, channel_min
from fourd.matting.motion.colour_models import Colours

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

MOST = np.float32(8.0)
"""Log-odds beyond which nothing is more certain."""
UNSURE = np.float32(0.25)
"""Share of the evidence against the subject that stands where the background is not known at all."""
MOVING_LOG_ODDS = np.float32(2.0)
OFF_HULL_LOG_ODDS = np.float32(-4.0)
HULL_REACHES = np.float32(-1.5)
"""Score from which a cell counts as the others' hull: below 0, since their evidence is not complete."""
HULL_DEPTH = np.float32(4.0)
"""Of a score above that, at which the others' hull is as sure as it gets."""
CONFIDENT = np.float32(4.0)
WITHIN_HULL_LOG_ODDS = 2.5
"""At most; see :func:`_within`."""
SMOOTHING = 20.0
COLOUR_EDGE = 8.0


@dataclass(frozen=True, eq=False)
class Look:
    """What one camera's subject and background look like.

    Attributes:
        background: by pixel.
        subject: colours of the subject.
        surroundings: colours of the background about it.
        region: (h, w) bool, outside which the subject never is.
        still_px: optical flow that is none.
    """

    background: Background
    subject: Colours
    surroundings: Colours
    region: NDArray[np.bool_]
    still_px: float

    def log_odds(self, rgb: Picture, motion: Floats | None) -> Floats:
        """(h, w) of a picture (h, w, 3) by this camera alone; ``motion`` in pixels where it is known."""
        sure = self.background.sureness
        surroundings = self.surroundings.log_likelihood(rgb)
        at_pixel = self.background.log_likelihood(rgb)
        mixed = np.logaddexp(at_pixel + np.log(0.95 * sure + 1e-4), surroundings + np.log(1 - 0.95 * sure))
        odds = np.clip(self.subject.log_likelihood(rgb) - mixed, -MOST, MOST)
        # Where the background is not known, colours alone should not deny the subject.
        odds = np.where(odds < 0, odds * (UNSURE + (1 - UNSURE) * sure), odds)
        if motion is not None:
            odds += (1 - sure) * np.clip(0.7 * (motion / self.still_px - 2), 0, MOVING_LOG_ODDS)
        odds[~self.region] = -MOST
        return np.asarray(cv2.GaussianBlur(odds.astype(np.float32), (3, 3), 0.6), np.float32)

    def at_scale(self, background: Background) -> Look:
        """The same look in the pixels of ``background``, which is this look's at another size."""
        height, width = background.frames.shape
        region = cv2.resize(self.region.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.25
        zoom = width / self.region.shape[1]
        return Look(background, self.subject, self.surroundings, region, self.still_px * zoom)

    def at_exposure(self, rgb: Picture) -> Picture:
        """The picture with each channel's exposure brought to the background's, told from where nothing moves."""
        still = ~self.region & (channel_min(self.background.mean) > 16) & (channel_max(rgb) < 250)
        if np.count_nonzero(still) < 100:
            return rgb
        gain = np.median(self.background.mean[still] / np.maximum(rgb[still], 1), axis=0)
        if np.abs(gain - 1).max() < 0.004:
            return rgb
        return np.clip(rgb * gain.astype(np.float32) + 0.5, 0, 255).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Views:
    """One frame's log-odds in all cameras, by each alone and with the others' word.

    Attributes:
        log_odds: per camera (h, w), smoothed along edges of the picture.
        uncovered: per camera (h, w) bool, where the other views' hull is not.
    """

    log_odds: tuple[Floats, ...]
    uncovered: tuple[NDArray[np.bool_], ...]


def joined(
    looks: Sequence[Look], pictures: Sequence[Picture], motions: Sequence[Floats | None], cells: Cells | None
) -> Views:
    """Each camera's log-odds with what the others' hull says of them.

    ``cells`` None, of cameras that are not calibrated or alone, leaves every camera to itself.
    """
    own = [look.log_odds(rgb, motion) for look, rgb, motion in zip(looks, pictures, motions, strict=True)]
    scores = None if cells is None else cells.scores(own)
    log_odds, uncovered = [], []
    for index, (look, rgb) in enumerate(zip(looks, pictures, strict=True)):
        odds = own[index]
        prior = np.full(odds.shape, NOWHERE) if scores is None else scores.prior(index)
        covered = prior > HULL_REACHES
        if scores is not None:
            depth = np.clip((prior - HULL_REACHES) / HULL_DEPTH, 0, 1)
            within = depth * _within(odds[covered & look.region])
            odds = odds + np.where(covered, within, OFF_HULL_LOG_ODDS)
        odds[~look.region] = -MOST
        log_odds.append(smoothed(odds, rgb))
        uncovered.append(~covered if scores is not None else np.zeros(odds.shape, bool))
    return Views(tuple(log_odds), tuple(uncovered))


def _within(own: Floats) -> np.float32:
    """Log-odds of a pixel within the others' hull, as the camera's own sure pixels (N,) there have it.

    A hull of many views is tight and tells much; one of a few is wide and tells little.
    """
    subject, other = np.count_nonzero(own > CONFIDENT), np.count_nonzero(own < -CONFIDENT)
    return np.float32(np.clip(np.log((subject + 1) / (other + 1)), 0, WITHIN_HULL_LOG_ODDS))


def smoothed(odds: Floats, rgb: Picture) -> Floats:
    """Log-odds (h, w) averaged within areas of one colour (fast global smoother, Min et al. 2014)."""
    return np.asarray(cv2.ximgproc.fastGlobalSmootherFilter(rgb, odds, SMOOTHING, COLOUR_EDGE), np.float32)


def probability(log_odds: Floats) -> Floats:
    """In [0, 1]."""
    return (1 / (1 + np.exp(-log_odds))).astype(np.float32)
