"""Learns what the subject and the background look like, without weights of any network.

Expectation maximisation over a few frames of all cameras. What moves is the subject; what a pixel shows most often
while nothing moves there is the background, unless its colour is the subject's; a pixel is the subject's as far as
its camera and the hull of the other cameras' pixels (:mod:`fourd.matting.motion.agreement`) agree. A subject that
keeps its place in one view is found by the others.
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
from fourd.matting.motion.agreement import Cells
from fourd.matting.motion.colour_models import Colours
from fourd.matting.motion.evidence import Look, joined, probability
from fourd.matting.motion.learner import Learner
from fourd.matting.motion.motion_extent import Swept
from fourd.matting.motion.sampling import CameraSample
from fourd.progress import Track

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

ROUNDS = 4
LEAST_REGION = 20
"""Sampled pixels that must change in some camera for there to be a subject."""
COARSE_CELLS = (48, 64, 64)
POOLED = 0.3
"""Share of a camera's subject that has the colours which all cameras see: a part may keep still in one view alone."""


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
    swept = [Swept.of(sample) for sample in track(samples, len(samples), "movement")]
    if max(int(view.region.sum()) for view in swept) < LEAST_REGION:
        raise UserError(
            "the pictures: expected a subject that moves, got nothing that changes in any camera; "
            "bring masks/CAM/FRAME.png, or use --method chroma before a screen of one colour"
        )
    box = _swept_box(swept, cameras, names)
    cells = None if box is None else Cells.filling(*box, cameras)
    regions = [view.region for view in swept] if cells is None else _regions(swept, cells)
    rng = np.random.default_rng(seed)
    seen = zip(samples, swept, regions, strict=True)
    learners = [
        Learner.begun(sample, view, region, rng) for sample, view, region in track(seen, len(samples), "beginning")
    ]
    _pool(learners)
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
        _pool(learners)
    return Subject(tuple(learner.look for learner in learners), cameras, box)


def _pool(learners: Sequence[Learner]) -> None:
    """Let each camera's subject have some of the colours that it has in the others."""
    together = Colours.mixed([learner.subject for learner in learners])
    for learner in learners:
        learner.set_subject(Colours.mixed([learner.subject, together], [1 - POOLED, POOLED]))


def _swept_box(swept: Sequence[Swept], cameras: Sequence[Camera], names: Sequence[str]) -> tuple[Array, Array] | None:
    """Where in space anything moves, as far as the views agree; None of one camera or of parallel ones."""
    focus = find_focus(list(cameras)) if len(cameras) > 1 else None
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
