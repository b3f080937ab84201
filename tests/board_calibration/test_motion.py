"""The motion of a board between frames."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fourd.recording.board_calibration.adjustment.motion import board_motion
from fourd.recording.board_calibration.adjustment.rig import Poses


def poses(times: np.ndarray) -> Poses:
    """A board that turns about z by 0.1 rad and accelerates along x."""
    turns = Rotation.from_rotvec(np.outer(0.1 * times, (0, 0, 1))).as_matrix()
    return Poses(turns, np.stack([0.01 * times**2, 0.02 * times, 0 * times], axis=1))


def test_motion_is_the_derivative_of_the_poses() -> None:
    """Catches a motion that ignores missing frames, and one-sided differences at frames that have both neighbours."""
    frames = [3, 4, 5, 7, 8, 9, 10]
    times = np.array(frames, float)
    motion = board_motion(frames, poses(times))
    expected = np.stack([0 * times, 0 * times, 0.1 + 0 * times, 0.02 * times, 0.02 + 0 * times, 0 * times], axis=1)
    assert np.abs(motion - expected).max() < 1e-9


def test_distant_frames_say_nothing_about_the_motion() -> None:
    """Catches a motion that is computed across a gap between frames, where the motion of the board is unknown."""
    frames = [0, 1, 2, 3, 50]
    motion = board_motion(frames, poses(np.array(frames, float)))
    assert np.abs(motion[3, 3:] - (0.06, 0.02, 0)).max() < 1e-9
    assert not motion[4].any()
