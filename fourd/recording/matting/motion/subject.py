"""Learning of subject and background models without a network.

The models are learned by expectation maximisation over a few frames of all cameras. Motion initialises the models:
moving pixels are the subject. A pixel's background is its most frequent colour in the frames in which the pixel
shows no motion, unless that colour is typical of the subject. The E-step combines the evidence of a pixel's own camera
with the visual hull of the other cameras (:mod:`fourd.recording.matting.motion.agreement`), so a subject that is static
in one view is found with the help of the other views.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera
from fourd.base.errors import UserError
from fourd.base.parallel import map_threads
from fourd.base.progress import Track
from fourd.recording.capture.focus import find_focus
from fourd.recording.capture.layout import sample_indices
from fourd.recording.matting.motion.agreement import MIN_SEEING_SHARE, VoxelGrid
from fourd.recording.matting.motion.colour_models import ColourHistogram
from fourd.recording.matting.motion.evidence import Appearance, ViewEvidence, combine_views, probability
from fourd.recording.matting.motion.learner import Learner
from fourd.recording.matting.motion.local_evidence import LocalEvidence, local_evidence
from fourd.recording.matting.motion.motion_extent import MotionExtent
from fourd.recording.matting.motion.sampling import CameraSample, Picture
from fourd.recording.matting.shadows.floor import Floor, find_floor, shaded_points
from fourd.recording.matting.shadows.floor_light import FloorGrid
from fourd.recording.matting.solid.moments import Moments
from fourd.recording.matting.solid.resting import SOLID_LOG_ODDS
from fourd.recording.matting.solid.subject import SolidSubject

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

ITERATIONS = 4
LOCAL_ITERATIONS = 2
"""Number of additional iterations after the first ITERATIONS iterations. Their E-step also uses local
colours (:mod:`fourd.recording.matting.motion.local_evidence`). In their M-step, a pixel with a low probability of the
subject counts as background even if it lies inside the visual hull of the other views. The background between the
subject's limbs thus becomes known, although the hull often covers it. The first additional iteration makes the
subject's edges more accurate. Some background pixels are covered by the subject in all frames except those in which the
subject's edge is next to them. With the more accurate edges, the second additional iteration also finds these
pixels."""
FLOOR_ITERATION = 2
"""Number of iterations after which the floor is looked for. The backgrounds are known well by then."""
FLOOR_FRAMES = 8
MIN_REGION_PIXELS = 20
"""Minimum number of changing pixels. If every camera has fewer changing pixels, the capture has no moving subject."""
COARSE_CELLS = (48, 64, 64)
MAX_COVERED = 0.95
"""If a larger fraction of the subject's points lies in the moving regions, the whole subject moves."""
POOLED_SHARE = 0.3
"""Weight in [0, 1] of the subject colours pooled over all cameras, when they are mixed with a camera's own subject
colours.

The pooled colours help where a part of the subject is static in one view.
"""


@dataclass(frozen=True, eq=False)
class Subject:
    """The learned models.

    Attributes:
        appearances: colour models of the subject and the background, one object per camera, at the size of the sampled
            images.
        cameras: cameras of the sampled images.
        box: minimum and maximum corner (3,) of the subject's bounding box over all frames, in world units. None
            for a single camera and for cameras with parallel optical axes, whose views are processed independently.
        min_seeing: the least fraction of the cameras that see a part of the subject.
        floor: the plane on which the subject's shadow lies, or None if no shadow was found.
        solid: points on the subject, or None if they were not needed.
    """

    appearances: tuple[Appearance, ...]
    cameras: tuple[Camera, ...]
    box: tuple[Array, Array] | None
    min_seeing: float = MIN_SEEING_SHARE
    floor: Floor | None = None
    solid: SolidSubject | None = None


def learn_subject(
    samples: Sequence[CameraSample],
    names: Sequence[str],
    seed: int,
    track: Track,
    moments: Moments | None = None,
    workers: int = 1,
    passed: Callable[[int], Iterable[Picture]] | None = None,
) -> Subject:
    """Learn the models of the subject and the backgrounds.

    Args:
        samples: sampled frames, one entry per camera.
        names: camera names for messages.
        seed: random seed for subsampling colours.
        track: progress callback.
        moments: points on all surfaces in some of the sampled frames, or None. They show parts of the subject that do
            not move.
        workers: number of threads.
        passed: returns images (h, w, 3) of the camera with the given index, of the size of its sampled images, between
            the sampled frames, or None. Only the regions in which something moves are learned from them.

    Raises:
        UserError: if no region changes, or if the moving regions of the views do not intersect in space.
    """
    cameras = tuple(sample.camera for sample in samples)
    extents = []
    for index, sample in enumerate(track(samples, len(samples), "motion")):
        extent = MotionExtent.from_sample(sample)
        extents.append(extent if passed is None else extent.including(sample, passed(index)))
    _require_motion(samples, extents)
    place = _Place.of_motion(extents, cameras, names)
    if moments is not None:
        place = place.with_still_parts(moments, samples, extents)
    # Each camera has its own random numbers, so that the result does not depend on the number of workers.
    rngs = np.random.default_rng(seed).spawn(len(samples))
    inputs = zip(samples, extents, place.regions, rngs, place.shown, strict=True)
    learners = [
        Learner.from_motion(sample, extent, region, rng, masks)
        for sample, extent, region, rng, masks in track(inputs, len(samples), "initialisation")
    ]
    _pool_subject_colours(learners)
    iterations = ITERATIONS + LOCAL_ITERATIONS
    floor: Floor | None = None
    for number in track(range(iterations), iterations, "learning"):
        if number >= FLOOR_ITERATION and floor is None:
            floor = _find_floor(learners, place, np.random.default_rng(seed))
        _iterate(learners, place, rngs, number >= ITERATIONS, workers, floor)
    appearances = tuple(learner.appearance for learner in learners)
    return Subject(appearances, cameras, place.box, place.min_seeing, floor, place.solid)


def floor_cells(floor: Floor | None, box: tuple[Array, Array] | None, grid: VoxelGrid | None) -> FloorGrid | None:
    """Divide the floor around the subject's box into cells of the voxels' size, for images of the voxels' cameras.
    Returns None if there is no floor."""
    if floor is None or box is None or grid is None:
        return None
    return FloorGrid.covering(floor, np.stack(box), grid.size, grid.cameras)


def _find_floor(learners: Sequence[Learner], place: _Place, rng: np.random.Generator) -> Floor | None:
    """Find the floor from the shadows in some of the sampled frames."""
    if place.grid is None or place.box is None:
        return None
    count = len(learners[0].sample.rgb)
    points = []
    for frame in sample_indices(count, min(count, FLOOR_FRAMES)):
        views = [each.appearance.background.observed_light(each.sample.rgb[frame]) for each in learners]
        points.append(shaded_points(place.grid.xyz, place.grid.pixels, views))
    return find_floor(np.concatenate(points), place.cameras, np.stack(place.box), place.grid.size, rng)


def _iterate(
    learners: Sequence[Learner],
    place: _Place,
    rngs: Sequence[np.random.Generator],
    is_local: bool,
    workers: int,
    floor: Floor | None,
) -> None:
    """Run one iteration of expectation maximisation, with local colours if ``is_local`` is true."""
    local = _local_evidence(learners) if is_local else None
    cells = floor_cells(floor, place.box, place.grid)

    def combine(frame: int) -> ViewEvidence:
        return combine_views(
            [learner.appearance for learner in learners],
            [learner.sample.rgb[frame] for learner in learners],
            [learner.sample.motion_px[frame].astype(np.float32) for learner in learners],
            place.grid,
            local,
            [_solid_log_odds(masks, frame) for masks in place.shown] if place.has_still_parts else None,
            cells,
        )

    frames = map_threads(combine, range(len(learners[0].sample.rgb)), workers)

    def update(index: int) -> None:
        alpha = np.stack([probability(views.log_odds[index]) for views in frames])
        off_hull = np.stack([views.off_hull[index] for views in frames])
        learners[index].update(alpha, off_hull, rngs[index], is_local)

    map_threads(update, range(len(learners)), workers)
    _pool_subject_colours(learners)


def _require_motion(samples: Sequence[CameraSample], extents: Sequence[MotionExtent]) -> None:
    """Raise UserError if no region changes."""
    if max(int(extent.region.sum()) for extent in extents) < MIN_REGION_PIXELS:
        is_single = all(len(sample.rgb) < 2 for sample in samples)
        got = "only one frame" if is_single else "no change in any camera"
        raise UserError(
            f"the images: expected a moving subject, got {got}; "
            "provide masks/CAM/FRAME.png, or use --method chroma with a screen of one colour"
        )


@dataclass(frozen=True, eq=False)
class _Place:
    """Where the subject is.

    Attributes:
        cameras: cameras of the sampled images.
        box: minimum and maximum corner (3,) in world units, or None for views that are processed independently.
        min_seeing: the least fraction of the cameras that see a part of the subject.
        grid: voxels of the box, or None.
        regions: for each camera, the mask (h, w) that contains the subject in all frames.
        shown: for each camera, masks (T, h, w) of pixels that show the subject although they may not move, or None.
        solid: the points from which ``shown`` was made, or None.
    """

    cameras: tuple[Camera, ...]
    box: tuple[Array, Array] | None
    min_seeing: float
    grid: VoxelGrid | None
    regions: list[Flags]
    shown: list[Flags | None]
    solid: SolidSubject | None = None

    @property
    def has_still_parts(self) -> bool:
        """Whether stereo found parts of the subject that motion lacks."""
        return any(masks is not None for masks in self.shown)

    @staticmethod
    def of_motion(extents: Sequence[MotionExtent], cameras: tuple[Camera, ...], names: Sequence[str]) -> _Place:
        """Find the subject from the moving regions alone."""
        box = _motion_box(extents, cameras, names)
        grid = None if box is None else VoxelGrid.covering(*box, cameras)
        regions = [extent.region for extent in extents] if grid is None else _subject_regions(extents, grid)
        return _Place(cameras, box, MIN_SEEING_SHARE, grid, regions, [None] * len(cameras))

    def with_still_parts(
        self, moments: Moments, samples: Sequence[CameraSample], extents: Sequence[MotionExtent]
    ) -> _Place:
        """Add what does not move, but is connected with something that moves."""
        if self.box is None:
            return self
        solid = SolidSubject.from_moments(moments, self.cameras, [extent.region for extent in extents])
        # Motion alone is more exact at contours than stereo.
        if solid is None or solid.covered_share(self.box, self.cameras, self.regions) > MAX_COVERED:
            return self
        box, min_seeing = solid.extend(self.box), solid.seeing_share(self.cameras)
        grid = VoxelGrid.covering(*box, self.cameras, min_seeing=min_seeing)
        shown = [solid.silhouettes(sample.camera, len(sample.rgb)) for sample in samples]
        regions = [_with_silhouettes(region, masks) for region, masks in zip(self.regions, shown, strict=True)]
        return _Place(self.cameras, box, min_seeing, grid, regions, list(shown), solid)


def _local_evidence(learners: Sequence[Learner]) -> list[LocalEvidence]:
    appearances = [learner.appearance for learner in learners]
    return local_evidence([each.background for each in appearances], [each.region for each in appearances])


def _pool_subject_colours(learners: Sequence[Learner]) -> None:
    """Mix the subject colours of all cameras into each camera's model."""
    pooled = ColourHistogram.mixture([learner.subject for learner in learners])
    for learner in learners:
        learner.set_subject(ColourHistogram.mixture([learner.subject, pooled], [1 - POOLED_SHARE, POOLED_SHARE]))


def _motion_box(
    extents: Sequence[MotionExtent], cameras: Sequence[Camera], names: Sequence[str]
) -> tuple[Array, Array] | None:
    """Return the bounding box of the visual hull of the moving regions, or None for a single camera or parallel
    cameras."""
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
                "the images: expected moving regions that intersect in space, got no intersection (camera "
                f"'{names[smallest]}' has the least motion); check calibration and synchronisation with fourd check"
            )
        box = found
    return box


def _subject_regions(extents: Sequence[MotionExtent], grid: VoxelGrid) -> list[Flags]:
    """Restrict each camera's moving region to the pixels onto which the visual hull of the other views projects, plus a
    margin.

    The restriction excludes people who move outside the volume that all cameras observe.
    """
    scores = grid.scores([_region_log_odds(extent.region) for extent in extents])
    regions = []
    for index, extent in enumerate(extents):
        hull = (scores.prior(index) > 0).astype(np.uint8)
        regions.append(extent.region & (cv2.dilate(hull, np.ones((7, 7), np.uint8)) > 0))
    return regions


def _region_log_odds(region: Flags) -> Floats:
    """Return the log-odds (h, w) for a binary region: 3 inside, -5 outside."""
    return np.where(region, np.float32(3), np.float32(-5))


def _with_silhouettes(region: Flags, masks: Flags) -> Flags:
    """Add the subject's silhouettes (T, h, w), with a margin, to the region (h, w)."""
    known = np.asarray(masks.any(axis=0), np.uint8)
    return np.asarray(region | (cv2.dilate(known, np.ones((7, 7), np.uint8)) > 0))


def _solid_log_odds(masks: Flags | None, frame: int) -> Floats | None:
    """Return the log-odds (h, w) in favour of the subject at pixels that its points cover in a frame."""
    if masks is None or not masks[frame].any():
        return None
    return np.where(masks[frame], SOLID_LOG_ODDS, np.float32(0))
