"""Learning of one camera's background from its frames and the hull of the other views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.recording.matting.motion.colour_models import ColourHistogram
from fourd.recording.matting.motion.learner import Learner
from fourd.recording.matting.motion.motion_extent import MOVING_FACTOR, MotionExtent
from fourd.recording.matting.motion.sampling import CameraSample

FRAMES, SIZE = 12, 64
FOOT, INNER = np.s_[32:44, 28:40], np.s_[34:42, 30:38]
FLOOR, SKIN, TOES = (60, 62, 58), (190, 140, 110), (250, 235, 215)


def sample_of(rgb: np.ndarray, motion_px: np.ndarray) -> CameraSample:
    intrinsics = np.array([[SIZE, 0, SIZE / 2], [0, SIZE, SIZE / 2], [0, 0, 1.0]])
    return CameraSample(Camera(intrinsics, np.eye(3), np.zeros(3), SIZE, SIZE), rgb, motion_px.astype(np.float16))


@dataclass(frozen=True)
class Scene:
    """A dark floor, a leg that passes over it, and toes of another colour that do not move."""

    sample: CameraSample
    region: np.ndarray
    leg: np.ndarray


@pytest.fixture
def scene(rng: np.random.Generator) -> Scene:
    rgb = np.empty((FRAMES, SIZE, SIZE, 3))
    rgb[:] = FLOOR
    motion = np.zeros((FRAMES, SIZE, SIZE))
    leg = np.zeros((FRAMES, SIZE, SIZE), bool)
    for frame in range(FRAMES):
        leg[frame, 10:30, 8 + 3 * frame : 16 + 3 * frame] = True
    rgb[leg], motion[leg] = SKIN, 3
    rgb[(slice(None), *FOOT)] = TOES
    rgb += rng.normal(0, 2, rgb.shape)
    region = np.zeros((SIZE, SIZE), bool)
    region[8:46, 6:54] = True
    return Scene(sample_of(np.clip(rgb, 0, 255).astype(np.uint8), motion), region, leg)


def run_learner(scene: Scene, off_hull: np.ndarray, rng: np.random.Generator, *, toes_known: bool = False) -> Learner:
    """A learner after two updates. If ``toes_known`` is True, the subject colours include the colour of the toes."""
    learner = Learner.from_motion(scene.sample, MotionExtent.from_sample(scene.sample), scene.region, rng)
    toes = ColourHistogram.from_colours(np.clip(rng.normal(TOES, 2, (500, 3)), 0, 255).astype(np.uint8))
    for _ in range(2):
        learner.set_subject(ColourHistogram.mixture([learner.subject, toes]) if toes_known else learner.subject)
        learner.update(np.where(scene.leg, 0.95, 0.05).astype(np.float32), off_hull, rng)
    return learner


@pytest.mark.parametrize(("toes_known", "max_confidence"), [(True, 0.1), (False, 0.6)])
def test_static_subject_inside_the_hull_is_not_background(
    toes_known: bool, max_confidence: float, scene: Scene, rng: np.random.Generator
) -> None:
    """Catches a static foot inside the hull that is learnt as background. The foot's colour is known from other
    cameras, or unknown."""
    off_hull = ~scene.leg
    off_hull[(slice(None), *FOOT)] = False
    background = run_learner(scene, off_hull, rng, toes_known=toes_known).appearance.background
    assert background.confidence[INNER].max() < max_confidence


def test_pixels_off_the_hull_are_known_background(scene: Scene, rng: np.random.Generator) -> None:
    """Catches a bright object outside the hull that is not learnt as background."""
    assert run_learner(scene, ~scene.leg, rng).appearance.background.confidence[INNER].min() > 0.9


def test_floor_inside_the_hull_is_known_by_its_colour(scene: Scene, rng: np.random.Generator) -> None:
    """Catches parts of the room that are learnt as foreground because the hull of a few views covers them in all
    frames."""
    off_hull = np.zeros_like(scene.leg)
    background = run_learner(scene, off_hull, rng).appearance.background
    under_leg = np.s_[12:28, 20:40]
    assert background.confidence[under_leg].mean() > 0.8
    assert np.abs(background.mean[under_leg] - FLOOR).mean() < 6


@pytest.mark.parametrize(("moves", "expected"), [(True, True), (False, False)])
def test_a_change_in_one_frame_counts_only_with_motion(moves: bool, expected: bool, rng: np.random.Generator) -> None:
    """Catches a swinging foot that is cut off because each pixel shows the foot in one frame only. Also catches a flash
    that counts as motion."""
    rgb = np.clip(rng.normal(60, 1, (FRAMES, SIZE, SIZE, 3)), 0, 255)
    motion = np.zeros((FRAMES, SIZE, SIZE))
    rgb[(5, *FOOT)] = SKIN
    if moves:
        motion[(5, *FOOT)] = MOVING_FACTOR + 1
    assert MotionExtent.from_sample(sample_of(rgb.astype(np.uint8), motion)).region[FOOT].all() == expected
