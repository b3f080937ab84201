"""Camera adjustment with synthetic features, noise and wrong matches, and with rendered images of a room."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.progress import untracked
from fourd.recording.calibration.adjustment.adjust import adjust_cameras, adjust_to_matches
from fourd.recording.calibration.adjustment.solver import Prior
from fourd.recording.calibration.adjustment.tracks import FrameMatches
from fourd.recording.calibration.perturbation import perturb_cameras, pose_errors
from fourd.recording.stereo.features import Features
from tests.calibration.rooms import Room, room_cameras
from tests.captures import ring_cameras

Matches = dict[tuple[int, int], NDArray[np.intp]]


def _frame_matches(cameras: list[Camera], rng: np.random.Generator, wrong: float, points: int = 400) -> FrameMatches:
    """Matches of points in a box with 0.25 px of noise. A fraction ``wrong`` of the matches is random."""
    xyz = rng.uniform(-0.8, 0.8, (points, 3))
    features = []
    for camera in cameras:
        pixels, _ = camera.project(xyz)
        features.append(Features(pixels + rng.normal(0, 0.25, pixels.shape), np.zeros((points, 0), np.float32)))
    matches: Matches = {}
    for i in range(len(cameras)):
        for j in ((i + 1) % len(cameras), (i + 2) % len(cameras)):
            chosen = rng.choice(points, points // 3, replace=False)
            other = np.where(rng.random(len(chosen)) < wrong, rng.permutation(points)[: len(chosen)], chosen)
            matches[i, j] = np.column_stack([chosen, other])
    return FrameMatches(tuple(features), matches)


def _named(cameras: list[Camera] | tuple[Camera, ...]) -> dict[str, Camera]:
    return {str(index): camera for index, camera in enumerate(cameras)}


def _prior(cameras: list[Camera], focal: float) -> Prior:
    return Prior(np.radians(0.5), np.full(len(cameras), 0.01), focal)


def _means(truth: list[Camera], cameras: list[Camera] | tuple[Camera, ...]) -> tuple[float, float]:
    errors = pose_errors(_named(truth), _named(cameras)).values()
    return float(np.mean([error.degrees for error in errors])), float(np.mean([error.distance for error in errors]))


def test_adjustment_reduces_pose_errors(rng: np.random.Generator) -> None:
    """Catches wrong Jacobians, sensitivity to wrong matches, and a drift of all cameras that the prior must prevent."""
    truth = ring_cameras(10, 512)
    given = list(perturb_cameras(_named(truth), 0.5, 0.01, rng).values())
    found = adjust_to_matches(given, [_frame_matches(truth, rng, wrong=0.15)], _prior(given, 0.002), 0.03)
    before, after = _means(truth, given), _means(truth, found.cameras)
    assert after[0] < 0.25 * before[0]
    assert after[1] < 0.6 * before[1]
    assert found.after_px < 0.5 < 1.0 < found.before_px
    unaligned = [np.linalg.norm(one.centre - other.centre) for one, other in zip(truth, found.cameras, strict=True)]
    assert np.mean(unaligned) < 0.012
    zooms = [now.intrinsics[0, 0] / was.intrinsics[0, 0] for now, was in zip(found.cameras, truth, strict=True)]
    assert max(abs(zoom - 1) for zoom in zooms) < 0.004


def test_fixed_parameters_stay_fixed(rng: np.random.Generator) -> None:
    """Catches changes of fixed parameters, which are the focal lengths or the poses."""
    truth = ring_cameras(8, 256)
    given = list(perturb_cameras(_named(truth), 0.3, 0.005, rng).values())
    frame = _frame_matches(truth, rng, wrong=0.0)
    poses = adjust_to_matches(given, [frame], _prior(given, 0.0), 0.03).cameras
    assert all(np.array_equal(now.intrinsics, was.intrinsics) for now, was in zip(poses, given, strict=True))
    held = Prior(0.0, np.zeros(len(given)), 0.01)
    focal = adjust_to_matches(given, [frame], held, 0.03).cameras
    for now, was in zip(focal, given, strict=True):
        assert np.allclose(now.rotation, was.rotation, rtol=0, atol=1e-12)
        assert np.allclose(now.centre, was.centre, rtol=0, atol=1e-12)


def test_cameras_without_matches_stay_as_given(rng: np.random.Generator) -> None:
    """Catches cameras moved by a few random matches, and a crash if there are no features."""
    truth = ring_cameras(6, 256)
    frame = _frame_matches(truth, rng, wrong=0.0)
    alone = {pair: rows for pair, rows in frame.matches.items() if 5 not in pair}
    few = {pair: rows[:4] for pair, rows in frame.matches.items() if 5 in pair}
    found = adjust_to_matches(truth, [FrameMatches(frame.features, alone | few)], _prior(truth, 0.0), 0.03)
    assert found.features[5] == 0
    assert np.array_equal(found.cameras[5].rotation, truth[5].rotation)
    none = adjust_to_matches(truth, [FrameMatches(frame.features, {})], _prior(truth, 0.0), 0.03)
    assert none.features.sum() == 0
    assert none.cameras == tuple(truth)


@dataclass(frozen=True)
class _RoomCapture:
    """One frame of a room. The class implements MaskSource."""

    cameras: tuple[Camera, ...]
    pictures: tuple[NDArray[np.uint8], ...]
    path: Path = Path("memory")
    frame_count: int = 1
    frame_numbers: tuple[int, ...] = (0,)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(_named(self.cameras))

    def mask(self, camera: int, frame: int) -> NDArray[np.uint8]:
        raise AssertionError("adjustment must not read masks")

    def image(self, camera: int, frame: int) -> NDArray[np.uint8]:
        return self.pictures[camera]


def test_adjustment_from_pictures_of_a_room() -> None:
    """Catches half-pixel offsets of features, and pairs that are matched in the wrong order."""
    rng = np.random.default_rng(3)
    truth = room_cameras(5, 320, 240)
    room = Room(rng)
    pictures = tuple(room.picture(camera) for camera in truth)
    given = list(perturb_cameras(_named(truth), 0.5, 0.01, rng).values())
    found = adjust_cameras(_RoomCapture(tuple(given), pictures), range(5), _prior(given, 0.0), 0.03, untracked)
    assert _means(truth, found.cameras)[0] < 0.4 * _means(truth, given)[0]
    assert found.after_px < 0.6
