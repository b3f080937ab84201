"""Log-odds that a pixel shows the subject, computed from the image of its camera and from the visual hull of the other
views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.matting.channels import channel_max, channel_min
from fourd.recording.matting.motion.agreement import NO_CELL_LOG_ODDS, VoxelGrid
from fourd.recording.matting.motion.background_model import BackgroundModel, Deviations
from fourd.recording.matting.motion.colour_models import ColourHistogram
from fourd.recording.matting.motion.local_evidence import LocalEvidence
from fourd.recording.matting.shadows.floor_light import FloorGrid, FloorLight

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

MAX_LOG_ODDS = np.float32(8.0)
"""Maximum magnitude to which log-odds are clamped."""
UNKNOWN_BACKGROUND_WEIGHT = np.float32(0.25)
"""Factor that multiplies negative log-odds, which are evidence against the subject, at pixels whose background colour
is unknown."""
MAX_MOTION_LOG_ODDS = np.float32(2.0)
OFF_HULL_LOG_ODDS = np.float32(-4.0)
HULL_THRESHOLD = np.float32(-1.5)
"""A voxel belongs to the other views' hull if its score is above this value. The score is approximately the lowest
log-odds that the voxel has in the other views. The threshold is below 0, because single views often give slightly
negative log-odds on the subject."""
HULL_RANGE = np.float32(4.0)
"""At pixels inside the other views' hull, log-odds in favour of the subject are added. They grow with the
largest score of the voxels that project onto the pixel, from 0 at the score HULL_THRESHOLD to their maximum at the
score HULL_THRESHOLD + HULL_RANGE."""
CONFIDENT_LOG_ODDS = np.float32(4.0)
MAX_INSIDE_HULL_LOG_ODDS = 2.5
"""Upper limit of the log-odds that are added at pixels inside the other views' hull onto which no reliable voxel
projects."""
RELIABLE_SCORE = np.float32(4.0)
"""Voxels with a score above this value are reliable: even the view with the lowest log-odds shows the subject at the
voxel."""
RELIABLE_RANGE = np.float32(2.0)
MAX_RELIABLE_LOG_ODDS = 6.0
"""Upper limit of the log-odds that are added at pixels onto which a reliable voxel projects.

The limit is large enough to decide pixels whose colour occurs both on the subject and in the background.
"""
SMOOTHING = 20.0
COLOUR_EDGE = 8.0


@dataclass(frozen=True, eq=False)
class Appearance:
    """Colour models of the subject and the background in one camera.

    Attributes:
        background: per-pixel background model.
        subject: colours of the subject.
        surround: colours of the background near the subject.
        region: (h, w) bool mask that contains the subject in all frames.
        still_px: typical length in pixels of the optical flow that noise causes at static pixels.
        deviations: how large a fraction of the background pixels differs in colour from the background model.
    """

    background: BackgroundModel
    subject: ColourHistogram
    surround: ColourHistogram
    region: NDArray[np.bool_]
    still_px: float
    deviations: Deviations = field(default_factory=Deviations)

    def log_odds(self, rgb: Picture, motion: Floats | None, floor: FloorLight | None = None) -> Floats:
        """Return the log-odds (h, w) that the pixels of an image (h, w, 3) show the subject, without the visual hull.

        ``motion`` (h, w) is the length of the optical flow in pixels, or None for a capture of one frame. ``floor`` is
        the light on the floor that the cameras agree on, or None.
        """
        confidence = self.background.confidence
        surround = self.surround.log_likelihood(rgb)
        at_pixel = self.background.log_likelihood(rgb, self.deviations.shaded, floor)
        known = np.float32(1 - self.deviations.changed) * confidence
        background = np.logaddexp(at_pixel + np.log(known + 1e-4), surround + np.log(1 - known))
        odds = np.clip(self.subject.log_likelihood(rgb) - background, -MAX_LOG_ODDS, MAX_LOG_ODDS)
        # Where the background is unknown, a pixel's colour is only weak evidence against the subject.
        weight = UNKNOWN_BACKGROUND_WEIGHT + (1 - UNKNOWN_BACKGROUND_WEIGHT) * confidence
        odds = np.where(odds < 0, odds * weight, odds)
        if motion is not None:
            odds += (1 - confidence) * np.clip(0.7 * (motion / self.still_px - 2), 0, MAX_MOTION_LOG_ODDS)
        odds[~self.region] = -MAX_LOG_ODDS
        return np.asarray(cv2.GaussianBlur(odds.astype(np.float32), (3, 3), 0.6), np.float32)

    def with_background(self, background: BackgroundModel) -> Appearance:
        """Resize the appearance to the size of ``background``, and use ``background`` as its background model."""
        height, width = background.frames.shape
        region = cv2.resize(self.region.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.25
        zoom = width / self.region.shape[1]
        return replace(self, background=background, region=region, still_px=self.still_px * zoom)

    def match_exposure(self, rgb: Picture) -> Picture:
        """Scale each channel of an image to the exposure of the background model.

        The gains of the channels are estimated from pixels outside the subject's region.
        """
        still = ~self.region & (channel_min(self.background.mean) > 16) & (channel_max(rgb) < 250)
        if np.count_nonzero(still) < 100:
            return rgb
        gain = np.median(self.background.mean[still] / np.maximum(rgb[still], 1), axis=0)
        if np.abs(gain - 1).max() < 0.004:
            return rgb
        return np.clip(rgb * gain.astype(np.float32) + 0.5, 0, 255).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class ViewEvidence:
    """Combined log-odds of one frame in all cameras.

    Attributes:
        log_odds: one array (h, w) per camera, smoothed within areas of similar colour.
        off_hull: one bool array (h, w) per camera, True at pixels outside the visual hull of the other views.
    """

    log_odds: tuple[Floats, ...]
    off_hull: tuple[NDArray[np.bool_], ...]


def combine_views(
    appearances: Sequence[Appearance],
    pictures: Sequence[Picture],
    motions: Sequence[Floats | None],
    grid: VoxelGrid | None,
    local: Sequence[LocalEvidence] | None = None,
    painted: Sequence[Floats | None] | None = None,
    floor: FloorGrid | None = None,
) -> ViewEvidence:
    """Combine each camera's log-odds with the visual hull of the other views.

    Args:
        appearances: colour models of each camera.
        pictures: one frame's image (h, w, 3) of each camera.
        motions: length (h, w) of the optical flow in pixels in each camera, or None for a capture of one frame.
        grid: voxels of the hull, or None for a single camera or parallel cameras, which are processed independently.
        local: each camera's local background colours (colour distributions that vary over the image), or None. If they
            are given, a second pass follows. It computes local colours of the subject from the result of the first
            pass, adds the evidence of both kinds of local colours to each camera's log-odds, and carves the hull again.
        painted: for each camera, the log-odds (h, w) that the user painted; 0 where nothing is painted.
        floor: the floor on which the subject's shadow lies, or None.
    """
    strokes = [None] * len(pictures) if painted is None else painted
    lights = _floor_lights(appearances, pictures, floor)
    own = [
        appearance.log_odds(rgb, motion, light)
        for appearance, rgb, motion, light in zip(appearances, pictures, motions, lights, strict=True)
    ]
    own = [_add_strokes(odds, stroke) for odds, stroke in zip(own, strokes, strict=True)]
    views = _add_hull(appearances, own, pictures, grid)
    if local is not None:
        corrected = [
            evidence.add(odds, combined, rgb, appearance.subject)
            for evidence, odds, combined, rgb, appearance in zip(
                local, own, views.log_odds, pictures, appearances, strict=True
            )
        ]
        corrected = [_add_strokes(odds, stroke) for odds, stroke in zip(corrected, strokes, strict=True)]
        views = _add_hull(appearances, corrected, pictures, grid)
    if painted is None:
        return views
    fixed = [_add_strokes(odds, stroke) for odds, stroke in zip(views.log_odds, strokes, strict=True)]
    return ViewEvidence(tuple(fixed), views.off_hull)


def _floor_lights(
    appearances: Sequence[Appearance], pictures: Sequence[Picture], floor: FloorGrid | None
) -> Sequence[FloorLight | None]:
    if floor is None:
        return [None] * len(pictures)
    views = [each.background.observed_light(rgb) for each, rgb in zip(appearances, pictures, strict=True)]
    return floor.light(views)


def _add_strokes(odds: Floats, painted: Floats | None) -> Floats:
    """Add painted log-odds, and clamp the sum's magnitude at painted pixels to MAX_LOG_ODDS."""
    if painted is None:
        return odds
    return np.where(painted == 0, odds, np.clip(odds + painted, -MAX_LOG_ODDS, MAX_LOG_ODDS))


def _add_hull(
    appearances: Sequence[Appearance], own: Sequence[Floats], pictures: Sequence[Picture], grid: VoxelGrid | None
) -> ViewEvidence:
    """Add the evidence of the other views' visual hull to the log-odds ``own`` (h, w) of each camera."""
    if grid is None:
        priors = [np.full(odds.shape, NO_CELL_LOG_ODDS) for odds in own]
    else:
        scores = grid.scores(own)
        priors = [scores.prior(index) for index in range(len(own))]
    # For the reliable part of the hull (priors above RELIABLE_SCORE), one number is estimated from the pixels of all
    # views together: the log-odds that a pixel in this part shows the subject. A single view may fail to detect a part
    # of the subject, so an estimate from it alone would be biased.
    reliable_own = [
        odds[(prior > RELIABLE_SCORE) & each.region] for odds, prior, each in zip(own, priors, appearances, strict=True)
    ]
    reliable = _inside_hull_log_odds(np.concatenate(reliable_own), MAX_RELIABLE_LOG_ODDS)
    log_odds, off_hull = [], []
    for odds, prior, appearance, rgb in zip(own, priors, appearances, pictures, strict=True):
        on_hull = prior > HULL_THRESHOLD
        combined = odds.copy()
        if grid is not None:
            certainty = np.clip((prior - HULL_THRESHOLD) / HULL_RANGE, 0, 1)
            inside = certainty * _inside_hull_log_odds(odds[on_hull & appearance.region], MAX_INSIDE_HULL_LOG_ODDS)
            inside = np.maximum(inside, np.clip((prior - RELIABLE_SCORE) / RELIABLE_RANGE, 0, 1) * reliable)
            combined += np.where(on_hull, inside, OFF_HULL_LOG_ODDS)
        combined[~appearance.region] = -MAX_LOG_ODDS
        log_odds.append(smooth_log_odds(combined.astype(np.float32), rgb))
        off_hull.append(~on_hull if grid is not None else np.zeros(odds.shape, bool))
    return ViewEvidence(tuple(log_odds), tuple(off_hull))


def _inside_hull_log_odds(own: Floats, limit: float) -> np.float32:
    """Return the log-odds, at most ``limit``, that a pixel inside the other views' visual hull shows the subject.

    The result is estimated from ``own`` (N,), the log-odds of pixels inside the hull, each computed from one camera
    only. The hull of many views is tight and gives strong evidence, and the hull of a few views is wide and gives weak
    evidence.
    """
    subject, other = np.count_nonzero(own > CONFIDENT_LOG_ODDS), np.count_nonzero(own < -CONFIDENT_LOG_ODDS)
    return np.float32(np.clip(np.log((subject + 1) / (other + 1)), 0, limit))


def smooth_log_odds(odds: Floats, rgb: Picture) -> Floats:
    """Smooth log-odds (h, w) within areas of similar colour (fast global smoother, Min et al. 2014)."""
    return np.asarray(cv2.ximgproc.fastGlobalSmootherFilter(rgb, odds, SMOOTHING, COLOUR_EDGE), np.float32)


def probability(log_odds: Floats) -> Floats:
    """Convert log-odds to probabilities in [0, 1] by the logistic function."""
    return (1 / (1 + np.exp(-log_odds))).astype(np.float32)
