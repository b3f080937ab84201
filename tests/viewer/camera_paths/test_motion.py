"""Motion through key frames: where it passes, how fast, and where it rests."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.viewer.camera_paths.keys import KeyedPath, KeyFrame
from fourd.viewer.camera_paths.motion import Easing, Motion
from fourd.viewer.navigation.pose import Pose, pose_facing

UP = np.array([0.0, 0.0, 1.0])


def facing(x: float, y: float, z: float, field_of_view: float = 0.8) -> Pose:
    """A pose at (x, y, z) that looks at the origin."""
    return pose_facing(np.array([x, y, z]), np.zeros(3), UP, field_of_view)


def around(count: int, seed: int) -> list[Pose]:
    """Random poses around the origin."""
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    return [
        facing(*rng.uniform(-3, 3, 2), float(rng.uniform(1, 2)), float(rng.uniform(0.3, 1.2))) for _ in range(count)
    ]


def eyes(motion: Motion, times: np.ndarray) -> np.ndarray:
    return np.array([pose.eye for pose in motion.at(times)])


def speeds(motion: Motion, times: np.ndarray, step: float = 1e-4) -> np.ndarray:
    return np.linalg.norm(eyes(motion, times + step) - eyes(motion, times - step), axis=1) / (2 * step)


@pytest.mark.parametrize("loop", [None, 9.0])
def test_the_motion_passes_through_its_key_frames(loop: float | None) -> None:
    """Catches key frames that the camera misses, because of rounding or of a wrong time."""
    poses, seconds = around(5, 3), np.array([0.0, 1.0, 1.5, 4.0, 6.0])
    motion = Motion(poses, seconds, ["smooth"] * 5, loop)
    for pose, found in zip(poses, motion.at(seconds), strict=True):
        assert found is pose
    if loop is not None:
        assert motion.at(np.array([loop]))[0] is poses[0]
        np.testing.assert_allclose(motion.at(np.array([loop - 1e-9]))[0].eye, poses[0].eye, atol=1e-6)


@pytest.mark.parametrize("loop", [None, 9.0])
def test_the_motion_is_smooth(loop: float | None) -> None:
    """Catches a jump of the position, the speed or the turn at a key frame, and at the seam of a loop."""
    poses, seconds = around(5, 7), np.array([0.0, 1.0, 1.5, 4.0, 6.0])
    motion = Motion(poses, seconds, ["smooth"] * 5, loop)
    seams = seconds[1:-1] if loop is None else seconds[1:]
    for seam in seams:
        before, at, after = (motion.at(np.array([seam + offset]))[0] for offset in (-1e-4, 0, 1e-4))
        np.testing.assert_allclose(after.eye - at.eye, at.eye - before.eye, atol=1e-5)
        np.testing.assert_allclose(after.rotation - at.rotation, at.rotation - before.rotation, atol=1e-5)
        assert after.field_of_view - at.field_of_view == pytest.approx(
            at.field_of_view - before.field_of_view, abs=1e-5
        )
    if loop is not None:
        start, end = motion.at(np.array([1e-4]))[0], motion.at(np.array([loop - 1e-4]))[0]
        np.testing.assert_allclose(start.eye - poses[0].eye, poses[0].eye - end.eye, atol=1e-5)
        np.testing.assert_allclose(start.rotation - poses[0].rotation, poses[0].rotation - end.rotation, atol=1e-5)


def test_rotations_stay_rotations_and_turn_the_short_way() -> None:
    """Catches quaternions of opposite signs, with which the camera turns the long way around."""
    poses = [facing(3 * np.cos(a), 3 * np.sin(a), 1.0) for a in (0.0, 2.0, 4.0, 6.0)]
    motion = Motion(poses, np.arange(4.0), ["smooth"] * 4)
    for pose in motion.at(np.linspace(0, 3, 60)):
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-9)
        assert pose.rotation[2] @ (-pose.eye / np.linalg.norm(pose.eye)) > 0.85, "the camera looks away from the origin"


def test_a_stop_is_a_stop_and_a_cut_is_a_cut() -> None:
    """Catches easing that has no effect, and a camera that flies from one side of a cut to the other."""
    poses: list[Pose] = around(4, 11)
    easing: list[Easing] = ["smooth", "stop", "cut", "smooth"]
    motion = Motion(poses, np.arange(4.0), easing)
    slow, fast = speeds(motion, np.array([1.0, 0.5]))
    assert slow < 0.01 * fast
    resting = motion.at(np.array([2.0, 2.3, 2.999, 3.0]))
    assert [pose is poses[2] for pose in resting] == [True, True, True, False]
    assert resting[3] is poses[3]


def test_a_camera_that_rests_between_equal_keys_does_not_move() -> None:
    """Catches splines that swing between two equal key frames."""
    first, second = around(2, 5)
    motion = Motion([first, second, second, first], np.arange(4.0), ["smooth"] * 4)
    still = eyes(motion, np.linspace(1, 2, 9)[:-1])
    np.testing.assert_array_equal(still, np.tile(second.eye, (8, 1)))
    assert speeds(motion, np.array([2.5]))[0] > 0.1


def test_uneven_distances_make_no_loops_and_no_way_back() -> None:
    """Catches splines over equal parameters, which overshoot at key frames that are close together."""
    poses = [facing(x, -5.0, 1.0) for x in (-4.0, -3.9, 3.9, 4.0)]
    motion = Motion(poses, np.array([0.0, 3.0, 3.5, 8.0]), ["smooth"] * 4)
    x = eyes(motion, np.linspace(0, 8, 400))[:, 0]
    assert np.diff(x).min() > -1e-9
    assert x.max() <= 4 + 1e-9


def test_frames_are_monotone_and_need_not_be_in_every_key() -> None:
    """Catches a scene that plays backwards between two key frames, because a spline overshoots."""
    frames = (0.0, None, 1.0, 40.0, 40.0)
    poses = around(5, 2)
    keys = tuple(KeyFrame(pose, float(i), frame) for i, (pose, frame) in enumerate(zip(poses, frames, strict=True)))
    samples = KeyedPath(keys, 25.0).path().samples
    shown = np.array([sample.frame for sample in samples])
    assert len(samples) == 101
    assert np.diff(shown).min() >= 0
    assert (shown[0], shown[50], shown[75], shown[-1]) == (0, 1, 40, 40)
    assert set(shown[75:]) == {40}


def test_the_number_of_images_and_of_images_of_a_loop() -> None:
    """Catches a loop that shows its first image twice, and a path without its last key frame."""
    poses = around(3, 4)
    keys = tuple(KeyFrame(pose, 0.5 * index) for index, pose in enumerate(poses))
    path = KeyedPath(keys, 10.0).path()
    assert len(path.samples) == 11
    assert path.samples[-1].pose is poses[-1]
    assert not path.has_frames
    loop = KeyedPath(keys, 10.0, 2.0).path()
    assert len(loop.samples) == 20
    assert loop.samples[-1].pose is not poses[0]
    assert len(loop.with_count(7).samples) == 7
    assert path.with_count(3).samples[1].pose is poses[1], "resampled from the curve, not from the images"
    single = KeyedPath(keys[:1], 10.0).path()
    assert [sample.pose for sample in single.samples] == [poses[0]]
    assert [sample.pose for sample in single.with_count(3).samples] == [poses[0]] * 3


def test_keys_must_follow_each_other() -> None:
    """Catches two key frames at the same time, between which the speed would be infinite."""
    poses = around(2, 1)
    with pytest.raises(ValueError, match=r"keys\[1\], seconds: expected more than 1 of the key before it, got 1"):
        KeyedPath((KeyFrame(poses[0], 1.0), KeyFrame(poses[1], 1.0)))
    with pytest.raises(ValueError, match="loop_seconds: expected more than 2"):
        KeyedPath((KeyFrame(poses[0], 1.0), KeyFrame(poses[1], 2.0)), 30.0, 1.5)
    with pytest.raises(ValueError, match="expected at most 100000 images"):
        KeyedPath((KeyFrame(poses[0], 0.0), KeyFrame(poses[1], 80000.0)), 30.0)
