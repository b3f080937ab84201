"""What one camera's sampled frames tell of the subject and the background, given what the others say of each pixel."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.matting.motion.background_model import Background, commonest
from fourd.matting.motion.channels import channel_max
from fourd.matting.motion.colour_models import Colours
from fourd.matting.motion.evidence import Look, probability
from fourd.matting.motion.local_colours import NearbyColours
from fourd.matting.motion.motion_extent import Swept
from fourd.matting.motion.sampling import CameraSample

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Picture = NDArray[np.uint8]

MOST_COLOURS = 200_000
AROUND_PX = 20
"""Width of the surroundings whose colours stand for the background's, in sampled pixels."""
LEAST_WEIGHT = np.float32(0.04)
CLEAR = np.float32(1.0)
"""Log-odds of a colour from which it is clearly the subject's, or below minus which clearly the surroundings'."""
CLEAR_SLOPE = np.float32(2.0)
LEAST_LIKENESS = np.float32(0.02)
PROVEN_FRAMES = 1.5
"""Frames that must show a colour while the others' hull is elsewhere for it to be known as the background's."""
LEAST_PROOF = np.float32(0.03)


@dataclass(eq=False)
class Learner:
    """One camera's side of the expectation maximisation.

    Attributes:
        sample: the camera's frames.
        swept: where anything moves in them.
        look: as learned so far.
        subject: colours of the subject in this camera alone.
    """

    sample: CameraSample
    swept: Swept
    look: Look
    subject: Colours = field(init=False)
    _around: Flags = field(init=False)
    _still: Floats = field(init=False)
    _median: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.subject = self.look.subject
        self._around = _dilated(self.look.region, AROUND_PX)
        self._median = np.median(self.sample.rgb, axis=0).astype(np.float32)
        motion = np.stack([cv2.dilate(frame.astype(np.float32), np.ones((3, 3))) for frame in self.sample.motion_px])
        self._still = np.exp(-np.square(motion / (2.5 * self.swept.still_px))).astype(np.float32)

    @staticmethod
    def begun(sample: CameraSample, swept: Swept, region: Flags, rng: np.random.Generator) -> Learner:
        """From motion alone; the subject is in ``region`` (h, w)."""
        around = _dilated(region, AROUND_PX)
        ring = around & ~region
        outside = Colours.of(_some(sample.rgb[:, ring if ring.any() else around].reshape(-1, 3), rng))
        nothing = Background(*(np.zeros((*region.shape, 3), np.float32),) * 2, np.zeros(region.shape, np.float32))
        learner = Learner(sample, swept, Look(nothing, outside, outside, region, swept.still_px))
        learner._set_background(learner._still, learner._still)
        away = channel_max(np.abs(sample.rgb - learner.look.background.mean)) > swept.change
        moving = away & (sample.motion_px > 2.5 * swept.still_px) & region
        if moving.sum() < 200:
            moving = away & region
        learner.subject = Colours.of(_some(sample.rgb[moving], rng))
        learner.set_subject(learner.subject)
        weights = learner._still * _not_the_subjects(learner._colour_odds(ring))
        learner._set_background(weights, weights)
        return learner

    def set_subject(self, colours: Colours) -> None:
        """Take these for the subject's."""
        self.look = replace(self.look, subject=colours)

    def learn(self, alpha: Floats, uncovered: Flags, rng: np.random.Generator) -> None:
        """From the probabilities (T, h, w) of the frames' pixels, and where the other views' hull was not."""
        rgb = self.sample.rgb
        shown = np.stack([cv2.dilate(frame, np.ones((3, 3), np.uint8)) for frame in alpha])
        free = np.maximum(np.clip(1 - 1.5 * shown, 0, 1), LEAST_WEIGHT)
        free *= np.maximum(self._still, uncovered)
        odds = self._colour_odds(self._proven(free * uncovered))
        weights = free * np.maximum(_not_the_subjects(odds), np.float32(0.5) * uncovered)
        self._set_background(weights, weights * np.maximum(_the_backgrounds(odds), uncovered))
        sure = alpha > 0.8
        if sure.sum() > 500:
            self.subject = Colours.of(_some(rgb[sure], rng))
        not_subject = (alpha < 0.2) & self._around
        if not_subject.any():
            self.look = replace(self.look, surroundings=Colours.of(_some(rgb[not_subject], rng)))

    def _proven(self, weights: Floats) -> Flags:
        """(h, w), where the background is known for certain: by ``weights`` (T, h, w), or since nothing moves."""
        frames = self.look.background.shown(self.sample.rgb, weights, self.swept.noise)
        return self._around & (~self.look.region | (frames > PROVEN_FRAMES))

    def _colour_odds(self, known: Flags) -> Floats:
        """(T, h, w) log-odds of colours, the subject's against those of the ``known`` (h, w) background nearby."""
        plate = np.clip(self.look.background.mean, 0, 255).astype(np.uint8)
        nearby = NearbyColours.of(plate, known)
        odds = np.empty(self.sample.rgb.shape[:3], np.float32)
        for place, rgb in enumerate(self.sample.rgb):
            own = self.look.subject.log_likelihood(rgb) - nearby.log_likelihood(rgb)
            odds[place] = cv2.GaussianBlur(own, (5, 5), 1)
        return odds

    def _set_background(self, weights: Floats, proof: Floats) -> None:
        """The commonest colours by ``weights`` (T, h, w) where things move, and the median elsewhere.

        It is as sure as the frames' ``proof`` (T, h, w) makes it.
        """
        rgb = self.sample.rgb
        rows, columns = _window(self.look.region)
        mean = self._median.copy()
        variance = np.full_like(mean, (self.swept.noise + 1) ** 2)
        frames = np.full(mean.shape[:2], len(rgb), np.float32)
        part = self.look.region[rows, columns]
        cut = rgb[:, rows, columns]
        inner = commonest(cut, weights[:, rows, columns], self.swept.noise)
        shown = inner.shown(cut, proof[:, rows, columns], self.swept.noise)
        for whole, found in ((mean, inner.mean), (variance, inner.variance), (frames, shown)):
            whole[rows, columns][part] = found[part]
        self.look = replace(self.look, background=Background(mean, variance, frames))


def _not_the_subjects(odds: Floats) -> Floats:
    """In (0, 1]: low where a colour is clearly the subject's."""
    return np.maximum(probability(CLEAR_SLOPE * (CLEAR - odds)), LEAST_LIKENESS)


def _the_backgrounds(odds: Floats) -> Floats:
    """In (0, 1]: high where a colour is clearly the background's.

    A part of the subject that rests has a colour for as many frames as a background would. What the other views
    never see to be free is background by its colour alone.
    """
    return np.maximum(probability(CLEAR_SLOPE * (-CLEAR - odds)), LEAST_PROOF)


def _dilated(region: Flags, by_px: int) -> Flags:
    return np.asarray(cv2.dilate(region.astype(np.uint8), np.ones((2 * by_px + 1,) * 2, np.uint8)) > 0)


def _window(region: Flags) -> tuple[slice, slice]:
    left, top, width, height = cv2.boundingRect(region.astype(np.uint8))
    return slice(top, top + max(1, height)), slice(left, left + max(1, width))


def _some(rgb: Picture, rng: np.random.Generator) -> Picture:
    """Colours (N, 3), at most MOST_COLOURS of them."""
    return rgb if len(rgb) <= MOST_COLOURS else rgb[rng.integers(0, len(rgb), MOST_COLOURS)]
