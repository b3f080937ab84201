"""Log-odds that a pixel shows the subject, from the colours of the subject and the background near the pixel.

They are used where the background model does not know the background of the pixel itself, for example because the
subject covers it in all frames. The histograms of :class:`~fourd.recording.matting.motion.evidence.Appearance` cover
the whole image, so a colour that occurs both on the subject and on the floor is ambiguous. In a small part of the
image, few colours are ambiguous, because a part of the subject and the floor next to it usually have different colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.matting.motion.background_model import BackgroundModel
from fourd.recording.matting.motion.colour_models import ColourHistogram
from fourd.recording.matting.motion.local_colours import LocalColours

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

REACH_PX = 40.0
BINS = 12
MIN_CONFIDENCE = 0.9
SUBJECT_LOG_ODDS = np.float32(2.0)
"""A pixel's colour counts as a colour of the subject if the pixel's log-odds are above this value."""
GLOBAL_SHARE = 0.15
"""The subject's colour distribution at a pixel is a mixture of two: the distribution of its local colours, and the
distribution of its colours in the whole recording. GLOBAL_SHARE is the weight, in [0, 1], of the latter.

The local colours come only from nearby pixels that certainly show the subject. Without the mixture, a part of the
subject would be missed if none of these pixels has its colour.
"""
MAX_LOG_ODDS = np.float32(8.0)
WEIGHT = np.float32(1.0)


@dataclass(frozen=True, eq=False)
class LocalEvidence:
    """Local colours of one camera's background, around the subject.

    Attributes:
        window: rows and columns of the part of the image that contains the subject in every frame.
        background: local colours of the known background in the window.
        weight: one factor in [0, WEIGHT] per pixel of the window, which multiplies the local log-odds; 0 where the
            background is known.
    """

    window: tuple[slice, slice]
    background: LocalColours
    weight: Floats

    @staticmethod
    def from_background(background: BackgroundModel, region: NDArray[np.bool_]) -> LocalEvidence:
        """Collect the colours of one camera's background near ``region`` (h, w), which contains the subject in all
        frames. Only pixels whose background is known with a confidence above MIN_CONFIDENCE count."""
        left, top, width, height = cv2.boundingRect(region.astype(np.uint8))
        margin = round(REACH_PX / 2)
        window = (
            slice(max(0, top - margin), max(1, top + height + margin)),
            slice(max(0, left - margin), max(1, left + width + margin)),
        )
        plate = np.clip(background.mean[window], 0, 255).astype(np.uint8)
        confidence = background.confidence[window]
        colours = LocalColours.from_picture(plate, confidence > MIN_CONFIDENCE, REACH_PX, BINS)
        return LocalEvidence(window, colours, WEIGHT * (1 - confidence))

    def add(self, own: Floats, combined: Floats, rgb: Picture, subject: ColourHistogram) -> Floats:
        """Return the log-odds ``own`` plus the weighted local log-odds, for one frame's image ``rgb`` (h, w, 3).
        The local log-odds of a pixel compare how frequent its colour is on the subject and on the background near the
        pixel.

        ``own`` (h, w) are the log-odds from this camera only, and ``combined`` (h, w) also contain the evidence of the
        other views. Pixels where both are above SUBJECT_LOG_ODDS supply the subject's local colours. The histogram
        ``subject`` contains the subject's colours from the whole recording.
        """
        if not self.weight.any():
            return own
        part = np.ascontiguousarray(rgb[self.window])
        certain = np.minimum(own[self.window], combined[self.window]) > SUBJECT_LOG_ODDS
        local = LocalColours.from_picture(part, certain, REACH_PX, BINS).log_likelihood(part)
        general = subject.log_likelihood(part)
        front = np.logaddexp(local + np.log(1 - GLOBAL_SHARE), general + np.log(GLOBAL_SHARE))
        odds = cv2.GaussianBlur((front - self.background.log_likelihood(part)).astype(np.float32), (5, 5), 1)
        total = own.copy()
        total[self.window] += self.weight * np.clip(odds, -MAX_LOG_ODDS, MAX_LOG_ODDS)
        return np.clip(total, -MAX_LOG_ODDS, MAX_LOG_ODDS)


def local_evidence(backgrounds: Sequence[BackgroundModel], regions: Sequence[NDArray[np.bool_]]) -> list[LocalEvidence]:
    """Collect the local background colours of each camera from its background model and the region (h, w) of its images
    that the subject covers over time."""
    return [
        LocalEvidence.from_background(background, region)
        for background, region in zip(backgrounds, regions, strict=True)
    ]
