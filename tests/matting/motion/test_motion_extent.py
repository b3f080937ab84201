"""The regions of the images in which something moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.matting.motion.motion_extent import MotionExtent
from fourd.recording.matting.motion.sampling import CameraSample, learning_frames, passed_frames

SIZE = 64
Picture = NDArray[np.uint8]


def still_sample(rng: np.random.Generator) -> CameraSample:
    """Noisy images of a grey wall, before which a body moves at the left."""
    pictures = rng.normal(120, 2, (12, SIZE, SIZE, 3))
    for index, picture in enumerate(pictures):
        picture[20:60, 4 + index % 3 : 14 + index % 3] = 40
    camera = Camera(np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]]), np.eye(3), np.zeros(3), SIZE, SIZE)
    return CameraSample(camera, pictures.astype(np.uint8), np.zeros((12, SIZE, SIZE), np.float16))


def ball_at(rng: np.random.Generator, column: int) -> Picture:
    picture = rng.normal(120, 2, (SIZE, SIZE, 3))
    picture[10:16, column : column + 6] = (200, 60, 50)
    return picture.astype(np.uint8)


def test_a_ball_between_the_sampled_frames_is_in_the_region(rng: np.random.Generator) -> None:
    """Catches a ball that crosses the image between two sampled frames. It was missing, or half of it, in the mattes of
    a recording of two people in a dome, although every camera saw it."""
    sample = still_sample(rng)
    before = MotionExtent.from_sample(sample)
    assert not before.region[10:16, 30:60].any()
    after = before.including(sample, [ball_at(rng, column) for column in (30, 38, 46, 54)])
    assert after.region[10:16, 30:60].all()
    assert (after.region & before.region == before.region).all()
    assert not after.region[40:, 30:].any()


def test_flashes_and_specks_do_not_move(rng: np.random.Generator) -> None:
    """Catches a region that is the whole image after a flash or a change of the exposure, and one that grows with every
    frame by the errors of a video codec."""
    sample = still_sample(rng)
    before = MotionExtent.from_sample(sample)
    flash = np.minimum(sample.rgb[0].astype(np.int64) + 60, 255).astype(np.uint8)
    specks = sample.rgb[0].copy()
    specks[::9, ::9] = 255
    after = before.including(sample, [flash, specks])
    assert after.region[:, 30:].sum() == 0


def test_short_captures_are_looked_at_whole() -> None:
    """Catches frames that are read twice, and large captures that are read completely before anything is learned."""
    learning = learning_frames(150, 27)
    assert sorted([*learning, *passed_frames(150, 27, learning)]) == list(range(150))
    assert len(passed_frames(3000, 60, learning_frames(3000, 60))) * 60 <= 4096
    assert passed_frames(24, 20, learning_frames(24, 20)) == []
