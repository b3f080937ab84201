"""Learning of subject and background models without a network.

Expectation maximisation over a few frames of all cameras. It is initialised from motion: moving pixels are the
subject, and the most frequent colour of a pixel without motion is its background, unless it is a subject colour. The
E-step combines the evidence of a pixel's own camera with the hull of the other cameras
(:mod:`fourd.matting.motion.agreement`). A subject that does not move in one view is found by the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array, Camera
from fourd.capture.focus import find_focus
from fourd.errors import UserError
from fourd.matting.motion.agreement import VoxelGrid
from fourd.matting.motion.colour_models import ColourHistogram
from fourd.matting.motion.evidence import Appearance, combine_views, probability
from fourd.matting.motion.learner import Learner
from fourd.matting.motion.motion_extent import MotionExtent
from fourd.matting.motion.sampling import CameraSample
from fourd.progress import Track

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

ITERATIONS = 4
MIN_REGION_PIXELS = 20
"""Minimum number of changing pixels in some camera for a subject to exist."""
COARSE_CELLS = (48, 64, 64)
POOLED_SHARE = 0.3
"""Weight of all cameras' subject colours in each camera's model: a part of the subject may be static in one view."""


@dataclass(frozen=True, eq=False)
class Subject:
    """The learned models.

    Attributes:
        appearances: per camera, at the size of the sampled pictures.
        cameras: cameras of the sampled pictures.
        box: corners of the subject's bounding box over all frames, world units; None if views cannot be combined.
    """

    appearances: tuple[Appearance, ...]
    cameras: tuple[Camera, ...]
    box: tuple[Array, Array] | None


def learn_subject(samples: Sequence[CameraSample], names: Sequence[str], seed: int, track: Track) -> Subject:
    """Learn the models of the subject and the backgrounds.

    Args:
        samples: one per camera.
        names: camera names for messages.
        seed: random seed of colour subsampling.
        track: progress callback.

    Raises:
        UserError: if nothing moves, or the moving regions of the views do not intersect in space.
    """
    cameras = tuple(sample.camera for sample in samples)
    extents = [MotionExtent.from_sample(sample) for sample in track(samples, len(samples), "motion")]
    if max(int(extent.region.sum()) for extent in extents) < MIN_REGION_PIXELS:
        raise UserError(
            "the pictures: expected a subject that moves, got nothing that changes in any camera; "
            "provide masks/CAM/FRAME.png, or use --method chroma with a screen of one colour"
        )
    box = _motion_box(extents, cameras, names)
    grid = None if box is None else VoxelGrid.covering(*box, cameras)
    regions = [extent.region for extent in extents] if grid is None else _subject_regions(extents, grid)
    rng = np.random.default_rng(seed)
    inputs = zip(samples, extents, regions, strict=True)
    learners = [
        Learner.from_motion(sample, extent, region, rng)
        for sample, extent, region in track(inputs, len(samples), "initialisation")
    ]
    _pool_subject_colours(learners)
    for _ in track(range(ITERATIONS), ITERATIONS, "learning"):
        frames = [
            combine_views(
                [learner.appearance for learner in learners],
                [sample.rgb[frame] for sample in samples],
                [sample.motion_px[frame].astype(np.float32) for sample in samples],
                grid,
            )
            for frame in range(len(samples[0].rgb))
        ]
        for index, learner in enumerate(learners):
            alpha = np.stack([probability(views.log_odds[index]) for views in frames])
            learner.update(alpha, np.stack([views.off_hull[index] for views in frames]), rng)
        _pool_subject_colours(learners)
    return Subject(tuple(learner.appearance for learner in learners), cameras, box)


def _pool_subject_colours(learners: Sequence[Learner]) -> None:
    """Mix the subject colours of all cameras into each camera's model."""
    pooled = ColourHistogram.mixture([learner.subject for learner in learners])
    for learner in learners:
        learner.set_subject(ColourHistogram.mixture([learner.subject, pooled], [1 - POOLED_SHARE, POOLED_SHARE]))


def _motion_box(
    extents: Sequence[MotionExtent], cameras: Sequence[Camera], names: Sequence[str]
) -> tuple[Array, Array] | None:
    """Bounding box of the hull of the moving regions; None for a single camera or parallel cameras."""
    focus = find_focus(list(cameras)) if len(cameras) > 1 else None
    if focus is None:
        return None
    reach = 1.5 * max(float(np.linalg.norm(camera.centre - focus)) for camera in cameras)
    box = (focus - reach, focus + reach)
    for count in COARSE_CELLS:
        evidence = [_region_log_odds(extent.region) for extent in extents]
        found = VoxelGrid.covering(*box, cameras, count).scores(evidence).box()
        if found is None:
            smallest = min(range(len(extents)), key=lambda index: extents[index].region.mean())
            raise UserError(
                "the pictures: expected views that agree on where something moves, got no common region (camera "
                f"'{names[smallest]}' has the least motion); check calibration and synchronisation: fourd check"
            )
        box = found
    return box


def _subject_regions(extents: Sequence[MotionExtent], grid: VoxelGrid) -> list[Flags]:
    """Moving regions that lie on the common hull, with a margin; excludes people who move behind the scene."""
    scores = grid.scores([_region_log_odds(extent.region) for extent in extents])
    regions = []
    for index, extent in enumerate(extents):
        hull = (scores.prior(index) > 0).astype(np.uint8)
        regions.append(extent.region & (cv2.dilate(hull, np.ones((7, 7), np.uint8)) > 0))
    return regions


def _region_log_odds(region: Flags) -> Floats:
    """Log-odds (h, w) of a binary region: 3 inside, -5 outside."""
    return np.where(region, np.float32(3), np.float32(-5))
