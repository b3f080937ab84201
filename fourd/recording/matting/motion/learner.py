"""The M-step for one camera: it fits subject and background models to sampled frames and subject probabilities."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.matting.channels import channel_max
from fourd.recording.matting.motion.background_model import BackgroundModel, fit_background, fit_deviations
from fourd.recording.matting.motion.colour_models import ColourHistogram
from fourd.recording.matting.motion.evidence import Appearance, probability
from fourd.recording.matting.motion.local_colours import LocalColours
from fourd.recording.matting.motion.motion_extent import MotionExtent
from fourd.recording.matting.motion.sampling import CameraSample

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Picture = NDArray[np.uint8]

MAX_COLOURS = 200_000
SURROUND_PX = 20
"""Width in pixels of the band around the subject whose colours represent the background."""
MIN_WEIGHT = np.float32(0.04)
COLOUR_MARGIN = np.float32(1.0)
"""Two weights of a pixel decrease with the log-odds that its colour belongs to the subject. At log-odds of
COLOUR_MARGIN, the weight :func:`_background_weight` is 0.5. At log-odds of -COLOUR_MARGIN, the weight
:func:`_background_confirmation` is 0.5."""
COLOUR_SLOPE = np.float32(2.0)
MIN_BACKGROUND_WEIGHT = np.float32(0.02)
CONFIRMED_FRAMES = 1.5
"""A pixel's colour is confirmed as background if the total weight of matching frames exceeds this value.

A frame matches if, in this frame, the pixel is outside the other views' hull and its colour is near the colour of the
background model.
"""
CLEAR_PX = 8
"""Distance in pixels from the hull of the other views.

Only pixels at this distance or farther are used to learn the fraction of the background that changes, because closer
pixels may show parts of the subject that the hull misses.
"""
CERTAIN_CONFIDENCE = 0.9
MIN_CONFIRMATION = np.float32(0.03)
TRUST_SLOPE = np.float32(5.0)
"""If the argument ``is_trusted`` of :meth:`Learner.update` is true, each pixel counts as background with at least the
weight max(0, 1 - TRUST_SLOPE * p), where p is the probability that the pixel shows the subject."""


@dataclass(eq=False)
class Learner:
    """The state of one camera in expectation maximisation.

    Attributes:
        sample: sampled frames of the camera.
        extent: extent of motion in the sampled frames.
        appearance: current models of the camera, with subject colours that are pooled over all cameras.
        subject: subject colours from this camera only.
    """

    sample: CameraSample
    extent: MotionExtent
    appearance: Appearance
    subject: ColourHistogram = field(init=False)
    _near_subject: Flags = field(init=False)
    _stillness: Floats = field(init=False)
    _median: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.subject = self.appearance.subject
        self._near_subject = _dilate(self.appearance.region, SURROUND_PX)
        self._median = np.median(self.sample.rgb, axis=0).astype(np.float32)
        motion = np.stack([cv2.dilate(frame.astype(np.float32), np.ones((3, 3))) for frame in self.sample.motion_px])
        self._stillness = np.exp(-np.square(motion / (2.5 * self.extent.still_px))).astype(np.float32)

    @staticmethod
    def from_motion(
        sample: CameraSample, extent: MotionExtent, region: Flags, rng: np.random.Generator, solid: Flags | None = None
    ) -> Learner:
        """Initialise the models from motion.

        Args:
            sample: sampled frames of the camera.
            extent: extent of motion in the sampled frames.
            region: (h, w) mask that contains the subject in all frames.
            rng: random generator for subsampling colours.
            solid: (T, h, w) masks of pixels that show the subject although they may not move, or None.
        """
        near_subject = _dilate(region, SURROUND_PX)
        ring = near_subject & ~region
        ring_rgb = sample.rgb[:, ring if ring.any() else near_subject].reshape(-1, 3)
        surround = ColourHistogram.from_colours(_subsample(ring_rgb, rng))
        unknown = BackgroundModel(*(np.zeros((*region.shape, 3), np.float32),) * 2, np.zeros(region.shape, np.float32))
        learner = Learner(sample, extent, Appearance(unknown, surround, surround, region, extent.still_px))
        if solid is not None:
            learner._stillness = np.where(solid, np.float32(0), learner._stillness)
        learner._set_background(learner._stillness, learner._stillness)
        changed = channel_max(np.abs(sample.rgb - learner.appearance.background.mean)) > extent.threshold
        moving = changed & (sample.motion_px > 2.5 * extent.still_px) & region
        if moving.sum() < 200:
            moving = changed & region
        if solid is not None:
            moving |= solid
        learner.subject = ColourHistogram.from_colours(_subsample(sample.rgb[moving], rng))
        learner.set_subject(learner.subject)
        weights = learner._stillness * _background_weight(learner._colour_log_odds(ring))
        learner._set_background(weights, weights)
        return learner

    def set_subject(self, colours: ColourHistogram) -> None:
        """Replace the subject colours of ``appearance``."""
        self.appearance = replace(self.appearance, subject=colours)

    def update(self, alpha: Floats, off_hull: Flags, rng: np.random.Generator, is_trusted: bool = False) -> None:
        """Update the camera's models of subject and background.

        Args:
            alpha: (T, h, w) probabilities that a pixel shows the subject.
            off_hull: (T, h, w) bool, True outside the other views' visual hull.
            rng: random generator for subsampling colours.
            is_trusted: whether a low probability of the subject is sufficient to confirm background inside the other
                views' hull.
        """
        rgb = self.sample.rgb
        dilated = np.stack([cv2.dilate(frame, np.ones((3, 3), np.uint8)) for frame in alpha])
        free = np.maximum(np.clip(1 - 1.5 * dilated, 0, 1), MIN_WEIGHT)
        free *= np.maximum(self._stillness, off_hull)
        odds = self._colour_log_odds(self._confirmed_background(free * off_hull))
        weights = free * np.maximum(_background_weight(odds), np.float32(0.5) * off_hull)
        confirmation = np.maximum(_background_confirmation(odds), off_hull)
        if is_trusted:
            trusted = np.clip(1 - TRUST_SLOPE * alpha, 0, 1)
            weights, confirmation = np.maximum(weights, trusted), np.maximum(confirmation, trusted)
        self._set_background(weights, weights * confirmation)
        confident = alpha > 0.8
        if confident.sum() > 500:
            self.subject = ColourHistogram.from_colours(_subsample(rgb[confident], rng))
        not_subject = (alpha < 0.2) & self._near_subject
        if not_subject.any():
            surround = ColourHistogram.from_colours(_subsample(rgb[not_subject], rng))
            self.appearance = replace(self.appearance, surround=surround)
        self._fit_deviations(off_hull)

    def _fit_deviations(self, off_hull: Flags) -> None:
        """Learn two fractions of the known background: the fraction in shadow, and the fraction whose colour changes.
        Only pixels far from the hull are used.

        ``off_hull`` (T, h, w) is True outside the other views' visual hull. Frames without a hull are ignored.
        """
        rows, columns = _bounding_window(self.appearance.region)
        background = self.appearance.background.crop(rows, columns)
        known = self.appearance.region[rows, columns] & (background.confidence > CERTAIN_CONFIDENCE)
        densities = []
        for rgb, free in zip(self.sample.rgb[:, rows, columns], off_hull, strict=True):
            clear = cv2.erode(free.astype(np.uint8), np.ones((2 * CLEAR_PX + 1,) * 2, np.uint8))[rows, columns] > 0
            chosen = clear & known & (not free.all())
            changed = self.appearance.surround.log_likelihood(rgb[chosen])
            densities.append(np.stack([*(plane[chosen] for plane in background.plain_and_shaded(rgb)), changed]))
        deviations = fit_deviations(*np.concatenate(densities, axis=1))
        self.appearance = replace(self.appearance, deviations=deviations)

    def _confirmed_background(self, weights: Floats) -> Flags:
        """Return the mask (h, w) of the pixels near the subject whose background colour is known.

        The background colour is known outside the moving region. Inside the moving region, each pixel is tested
        separately. A pixel's ``weights`` (T, h, w), which are low in frames in which it may show the subject, are
        summed over the frames in which its colour matches the background model. Its background colour is known if this
        sum exceeds CONFIRMED_FRAMES.
        """
        frames = self.appearance.background.matching_weight(self.sample.rgb, weights, self.extent.noise)
        return self._near_subject & (~self.appearance.region | (frames > CONFIRMED_FRAMES))

    def _colour_log_odds(self, known: Flags) -> Floats:
        """Return the log-odds (T, h, w) of the subject against the nearby background, computed only from colours.

        The background colours come from the pixels in the mask ``known`` (h, w).
        """
        plate = np.clip(self.appearance.background.mean, 0, 255).astype(np.uint8)
        local = LocalColours.from_picture(plate, known)
        odds = np.empty(self.sample.rgb.shape[:3], np.float32)
        for frame, rgb in enumerate(self.sample.rgb):
            own = self.appearance.subject.log_likelihood(rgb) - local.log_likelihood(rgb)
            odds[frame] = cv2.GaussianBlur(own, (5, 5), 1)
        return odds

    def _set_background(self, weights: Floats, confirmation: Floats) -> None:
        """Fit the background model.

        Inside the subject's region, the background model is fitted with ``weights`` (T, h, w). The model's confidence
        is computed from the weights ``confirmation`` (T, h, w). Outside the subject's region, the model's mean is the
        median over time.
        """
        rgb = self.sample.rgb
        rows, columns = _bounding_window(self.appearance.region)
        mean = self._median.copy()
        variance = np.full_like(mean, (self.extent.noise + 1) ** 2)
        frames = np.full(mean.shape[:2], len(rgb), np.float32)
        region = self.appearance.region[rows, columns]
        cropped = rgb[:, rows, columns]
        inner = fit_background(cropped, weights[:, rows, columns], self.extent.noise)
        confirmed = inner.matching_weight(cropped, confirmation[:, rows, columns], self.extent.noise)
        for whole, fitted in ((mean, inner.mean), (variance, inner.variance), (frames, confirmed)):
            whole[rows, columns][region] = fitted[region]
        self.appearance = replace(self.appearance, background=BackgroundModel(mean, variance, frames))


def _background_weight(odds: Floats) -> Floats:
    """Return the weight in (0, 1] with which a pixel counts as background, computed from the log-odds that its colour
    belongs to the subject.

    Typical subject colours have a low background weight.
    """
    return np.maximum(probability(COLOUR_SLOPE * (COLOUR_MARGIN - odds)), MIN_BACKGROUND_WEIGHT)


def _background_confirmation(odds: Floats) -> Floats:
    """Return the weight in (0, 1] with which a colour confirms the background, computed from the log-odds that the
    colour belongs to the subject.

    Typical background colours have a high weight.

    Pixels that are always inside the other views' hull may show a static part of the subject. Its colour is as constant
    over time as the colour of the background, so a constant colour is no evidence for background at these pixels. Only
    a colour that is typical of the background counts as evidence.
    """
    return np.maximum(probability(COLOUR_SLOPE * (-COLOUR_MARGIN - odds)), MIN_CONFIRMATION)


def _dilate(region: Flags, by_px: int) -> Flags:
    return np.asarray(cv2.dilate(region.astype(np.uint8), np.ones((2 * by_px + 1,) * 2, np.uint8)) > 0)


def _bounding_window(region: Flags) -> tuple[slice, slice]:
    left, top, width, height = cv2.boundingRect(region.astype(np.uint8))
    return slice(top, top + max(1, height)), slice(left, left + max(1, width))


def _subsample(rgb: Picture, rng: np.random.Generator) -> Picture:
    """Choose at most MAX_COLOURS of the colours (N, 3) at random."""
    return rgb if len(rgb) <= MAX_COLOURS else rgb[rng.integers(0, len(rgb), MAX_COLOURS)]
