"""What one camera learns of its background from its frames and from the other views' word."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from fourd.cameras import Camera
from fourd.matting.motion.colour_models import Colours
from fourd.matting.motion.learner import Learner
from fourd.matting.motion.motion_extent import MOVING, Swept
from fourd.matting.motion.sampling import CameraSample

FRAMES, SIZE = 12, 64
FOOT, INNER = np.s_[32:44, 28:40], np.s_[34:42, 30:38]
FLOOR, SKIN, TOES = (60, 62, 58), (190, 140, 110), (250, 235, 215)


def sample_of(rgb: np.ndarray, motion_px: np.ndarray) -> CameraSample:
    intrinsics = np.array([[SIZE, 0, SIZE / 2], [0, SIZE, SIZE / 2], [0, 0, 1.0]])
    return CameraSample(Camera(intrinsics, np.eye(3), np.zeros(3), SIZE, SIZE), rgb, motion_px.astype(np.float16))


@dataclass(frozen=True)
class Scene:
    """A dark floor, a leg that passes over it, and toes of another colour that lie in one place in all frames."""

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


def learned(scene: Scene, uncovered: np.ndarray, rng: np.random.Generator, *, toes_known: bool = False) -> Learner:
    learner = Learner.begun(scene.sample, Swept.of(scene.sample), scene.region, rng)
    toes = Colours.of(np.clip(rng.normal(TOES, 2, (500, 3)), 0, 255).astype(np.uint8))
    for _ in range(2):
        learner.set_subject(Colours.mixed([learner.subject, toes]) if toes_known else learner.subject)
        learner.learn(np.where(scene.leg, 0.95, 0.05).astype(np.float32), uncovered, rng)
    return learner


@pytest.mark.parametrize(("toes_known", "most"), [(True, 0.1), (False, 0.6)])
def test_what_rests_within_the_others_hull_is_no_known_background(
    toes_known: bool, most: float, scene: Scene, rng: np.random.Generator
) -> None:
    """Catches a foot that becomes part of the floor it stands on, of a colour that other cameras know or none does."""
    uncovered = ~scene.leg
    uncovered[(slice(None), *FOOT)] = False
    background = learned(scene, uncovered, rng, toes_known=toes_known).look.background
    assert background.sureness[INNER].max() < most


def test_what_the_others_see_to_be_free_is_known_background(scene: Scene, rng: np.random.Generator) -> None:
    """Catches a bright thing on the floor that is never known, so that the others' word alone decides on it."""
    assert learned(scene, ~scene.leg, rng).look.background.sureness[INNER].min() > 0.9


def test_floor_is_known_by_its_colour_though_always_within_the_hull(scene: Scene, rng: np.random.Generator) -> None:
    """Catches pieces of the room about the subject that few views see between: the floor is the floor."""
    uncovered = np.zeros_like(scene.leg)
    background = learned(scene, uncovered, rng).look.background
    under_leg = np.s_[12:28, 20:40]
    assert background.sureness[under_leg].mean() > 0.8
    assert np.abs(background.mean[under_leg] - FLOOR).mean() < 6


@pytest.mark.parametrize(("moves", "expected"), [(True, True), (False, False)])
def test_what_is_seen_once_counts_when_it_moves(moves: bool, expected: bool, rng: np.random.Generator) -> None:
    """Catches a swinging foot that is cut off, which is in no place twice; and a flash that counts."""
    rgb = np.clip(rng.normal(60, 1, (FRAMES, SIZE, SIZE, 3)), 0, 255)
    motion = np.zeros((FRAMES, SIZE, SIZE))
    rgb[(5, *FOOT)] = SKIN
    if moves:
        motion[(5, *FOOT)] = MOVING + 1
    assert Swept.of(sample_of(rgb.astype(np.uint8), motion)).region[FOOT].all() == expected
