"""Learns what the subject and the background look like, without weights of any network.

Expectation maximisation over a few frames of all cameras. What moves is the subject; what a pixel shows most
often while nothing moves there is the background, unless its colour is the subject's; a pixel is the subject's as
far as its camera and the hull of the other cameras' pixels (:mod:`fourd.matting.agreement`) say so. A subject that
keeps its place in one view is found by the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array, Camera
from fourd.capture.check import nearest_to_axes
from fourd.errors import UserError
from fourd.matting.agreement import Cells
from fourd.matting.background import Background, commonest
from fourd.matting.colours import Colours
from fourd.matting.evidence import Look, joined, probability
from fourd.matting.sampling import CameraSample
from fourd.matting.swept import Swept
from fourd.progress import Track

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Picture = NDArray[np.uint8]

ROUNDS = 4
MOST_COLOURS = 200_000
AROUND_PX = 20
"""Width of the surroundings whose colours stand for the background's, in sampled pixels."""
LEAST_WEIGHT = np.float32(0.04)
DOUBTFUL = np.float32(1.0)
LIKENESS_SLOPE = np.float32(2.0)
LEAST_LIKENESS = np.float32(0.02)
"""A colour whose log-odds for the subject are above DOUBTFUL is hardly taken for the background's."""
LEAST_REGION = 20
"""Sampled pixels that must change in some camera for there to be a subject."""
COARSE_CELLS = (48, 64, 64)


@dataclass(frozen=True, eq=False)
class Subject:
    """What mattes of all frames are made by.

    Attributes:
        looks: per camera, in the sample's pixels.
        cameras: of the sample's pictures.
        box: corners of what the subject ever fills, world units; None where views cannot be joined.
    """

    looks: tuple[Look, ...]
    cameras: tuple[Camera, ...]
    box: tuple[Array, Array] | None


def learn_subject(samples: Sequence[CameraSample], names: Sequence[str], seed: int, track: Track) -> Subject:
    """Learn the subject's and the background's looks from ``samples``.

    Args:
        samples: one a camera.
        names: of the cameras, for messages.
        seed: of the colours that are drawn for distributions.
        track: for progress.

    Raises:
        UserError: when nothing moves, or what moves in the views meets nowhere.
    """
    cameras = tuple(sample.camera for sample in samples)
    swept = [Swept.of(sample) for sample in samples]
    if max(int(view.region.sum()) for view in swept) < LEAST_REGION:
        raise UserError(
            "the pictures: expected a subject that moves, got nothing that changes in any camera; "
            "bring masks/CAM/FRAME.png, or use --method chroma before a screen of one colour"
        )
    box = _swept_box(swept, cameras, names)
    cells = None if box is None else Cells.filling(*box, cameras)
    regions = [view.region for view in swept] if cells is None else _regions(swept, cells)
    rng = np.random.default_rng(seed)
    learners = [
        _Learner.begun(sample, view, region, rng) for sample, view, region in zip(samples, swept, regions, strict=True)
    ]
    for _ in track(range(ROUNDS), ROUNDS, "learning"):
        frames = [
            joined(
                [learner.look for learner in learners],
                [sample.rgb[frame] for sample in samples],
                [sample.motion_px[frame].astype(np.float32) for sample in samples],
                cells,
            )
            for frame in range(len(samples[0].rgb))
        ]
        for index, learner in enumerate(learners):
            alpha = np.stack([probability(views.log_odds[index]) for views in frames])
            learner.learn(alpha, np.stack([views.uncovered[index] for views in frames]), rng)
    return Subject(tuple(learner.look for learner in learners), cameras, box)


def _swept_box(swept: Sequence[Swept], cameras: Sequence[Camera], names: Sequence[str]) -> tuple[Array, Array] | None:
    """Where in space anything moves, as far as the views agree; None of one camera or of parallel ones."""
    focus = nearest_to_axes(list(cameras)) if len(cameras) > 1 else None
    if focus is None:
        return None
    reach = 1.5 * max(float(np.linalg.norm(camera.centre - focus)) for camera in cameras)
    box = (focus - reach, focus + reach)
    for count in COARSE_CELLS:
        found = Cells.filling(*box, cameras, count).scores([_yes_no(view.region) for view in swept]).box()
        if found is None:
            least = min(range(len(swept)), key=lambda index: swept[index].region.mean())
            raise UserError(
                "the pictures: expected views that agree on where something moves, got none in common (camera "
                f"'{names[least]}' sees least); check the calibration and the synchronisation: fourd check"
            )
        box = found
    return box


def _regions(swept: Sequence[Swept], cells: Cells) -> list[Flags]:
    """Where things move in a view and in space too, with a margin: others who move behind are left out."""
    scores = cells.scores([_yes_no(view.region) for view in swept])
    regions = []
    for index, view in enumerate(swept):
        hull = (scores.prior(index) > 0).astype(np.uint8)
        regions.append(view.region & (cv2.dilate(hull, np.ones((7, 7), np.uint8)) > 0))
    return regions


def _yes_no(region: Flags) -> Floats:
    return np.where(region, np.float32(3), np.float32(-5))


class _Learner:
    """One camera's side of the expectation maximisation."""

    def __init__(self, sample: CameraSample, swept: Swept, look: Look, around: Flags, outside: Colours) -> None:
        self.sample = sample
        self.swept = swept
        self.look = look
        self._around = around
        self._outside = outside
        motion = np.stack([cv2.dilate(frame.astype(np.float32), np.ones((3, 3))) for frame in sample.motion_px])
        self._still = np.exp(-np.square(motion / (2.5 * swept.still_px))).astype(np.float32)
        self._window = _window(look.region)

    @staticmethod
    def begun(sample: CameraSample, swept: Swept, region: Flags, rng: np.random.Generator) -> _Learner:
        """From motion alone."""
        around = cv2.dilate(region.astype(np.uint8), np.ones((2 * AROUND_PX + 1,) * 2, np.uint8)) > 0
        ring = around & ~region
        outside = Colours.of(_some(sample.rgb[:, ring if ring.any() else around].reshape(-1, 3), rng))
        nothing = Background(*(np.zeros((*region.shape, 3), np.float32),) * 2, np.zeros(region.shape, np.float32))
        look = Look(nothing, outside, outside, region, swept.still_px)
        learner = _Learner(sample, swept, look, around, outside)
        learner._set_background(learner._still)
        away = np.abs(sample.rgb - learner.look.background.mean).max(axis=-1) > swept.change
        moving = away & (sample.motion_px > 2.5 * swept.still_px) & region
        if moving.sum() < 200:
            moving = away & region
        learner._set_colours(Colours.of(_some(sample.rgb[moving], rng)), outside)
        learner._set_background(learner._still * learner._like_background())
        return learner

    def learn(self, alpha: Floats, uncovered: Flags, rng: np.random.Generator) -> None:
        """From the probabilities (T, h, w) of the frames' pixels, and where the other views' hull was not."""
        shown = np.stack([cv2.dilate(frame, np.ones((3, 3), np.uint8)) for frame in alpha])
        weights = np.maximum(np.clip(1 - 1.5 * shown, 0, 1), LEAST_WEIGHT)
        weights *= np.maximum(self._still, uncovered)
        weights *= np.maximum(self._like_background(), np.float32(0.5) * uncovered)
        self._set_background(weights)
        rgb = self.sample.rgb
        sure = alpha > 0.8
        subject = Colours.of(_some(rgb[sure], rng)) if sure.sum() > 500 else self.look.subject
        not_subject = (alpha < 0.2) & self._around
        self._set_colours(subject, Colours.of(_some(rgb[not_subject], rng)) if not_subject.any() else self._outside)

    def _like_background(self) -> Floats:
        """(T, h, w) in (0, 1]: low where a colour is clearly the subject's rather than the surroundings'."""
        likeness = np.empty(self.sample.rgb.shape[:3], np.float32)
        for place, rgb in enumerate(self.sample.rgb):
            odds = self.look.subject.log_likelihood(rgb) - self._outside.log_likelihood(rgb)
            likeness[place] = probability(LIKENESS_SLOPE * (DOUBTFUL - cv2.GaussianBlur(odds, (5, 5), 1)))
        return np.maximum(likeness, LEAST_LIKENESS)

    def _set_background(self, weights: Floats) -> None:
        """The commonest colours by ``weights`` where things move, and the median elsewhere."""
        rgb = self.sample.rgb
        rows, columns = self._window
        mean = np.median(rgb, axis=0).astype(np.float32)
        variance = np.full_like(mean, (self.swept.noise + 1) ** 2)
        frames = np.full(mean.shape[:2], len(rgb), np.float32)
        part = self.look.region[rows, columns]
        inner = commonest(rgb[:, rows, columns], weights[:, rows, columns], self.swept.noise)
        for whole, found in ((mean, inner.mean), (variance, inner.variance), (frames, inner.frames)):
            whole[rows, columns][part] = found[part]
        self.look = replace(self.look, background=Background(mean, variance, frames))

    def _set_colours(self, subject: Colours, surroundings: Colours) -> None:
        self.look = replace(self.look, subject=subject, surroundings=surroundings)


def _window(region: Flags) -> tuple[slice, slice]:
    left, top, width, height = cv2.boundingRect(region.astype(np.uint8))
    return slice(top, top + max(1, height)), slice(left, left + max(1, width))


def _some(rgb: Picture, rng: np.random.Generator) -> Picture:
    """Colours (N, 3), at most MOST_COLOURS of them."""
    return rgb if len(rgb) <= MOST_COLOURS else rgb[rng.integers(0, len(rgb), MOST_COLOURS)]
