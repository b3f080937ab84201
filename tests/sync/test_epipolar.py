"""Time offsets from the motion in epipolar planes, for discs that move along known paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.sync.epipolar import (
    MAX_PIXELS,
    PLANES,
    MotionRecord,
    common_planes,
    estimate_epipolar_offsets,
    plane_correlations,
)
from fourd.recording.sync.motion import motion_energy
from tests.captures import ring_cameras
from tests.sync.discs import SIZE, film, smooth_paths

Array = NDArray[np.float64]
FRAMES = 90


def film_shifted(
    cameras: Sequence[Camera], paths: Array, offsets: Sequence[int], rng: np.random.Generator
) -> list[MotionRecord]:
    """Motion of videos in which each event appears ``offsets`` frames later than in a video with the offset 0."""
    most = max(offsets)
    return [
        MotionRecord.of(film(camera, paths[most - offset : most - offset + FRAMES], rng))
        for camera, offset in zip(cameras, offsets, strict=True)
    ]


def test_offsets_of_smooth_motion_are_exact(rng: np.random.Generator) -> None:
    """Catches offsets of the wrong sign, planes that do not correspond between two cameras, and offsets that are as
    inexact as those from motion energies."""
    offsets = (0, 27, -12, 8)
    cameras = ring_cameras(4, SIZE)
    paths = smooth_paths(rng, FRAMES + 40)
    records = film_shifted(cameras, paths, offsets, rng)
    found = estimate_epipolar_offsets(records, cameras, max_offset=300)
    assert found is not None
    np.testing.assert_allclose(found.subframes, offsets, atol=1)
    assert min(found.confidence) > 0.5


def test_synchronous_videos_get_no_offset(rng: np.random.Generator) -> None:
    """Catches a bias towards late or early frames."""
    cameras = ring_cameras(4, SIZE)
    found = estimate_epipolar_offsets(film_shifted(cameras, smooth_paths(rng, FRAMES), (0,) * 4, rng), cameras, 300)
    assert found is not None
    np.testing.assert_allclose(found.subframes, 0, atol=0.5)


def test_cyclic_motion_is_not_sure(rng: np.random.Generator) -> None:
    """Catches an offset that is applied although another one, a whole cycle away, fits as well."""
    cameras = ring_cameras(4, SIZE)
    angles = 2 * np.pi * np.arange(FRAMES + 10) / 20
    paths = 0.4 * np.stack([np.cos(angles), np.sin(angles), np.cos(2 * angles)], axis=1)[:, None]
    found = estimate_epipolar_offsets(film_shifted(cameras, paths, (0, 7, 3, 0), rng), cameras, 300)
    assert found is not None
    assert max(found.confidence) < 0.3


def test_unrelated_videos_are_not_sure(rng: np.random.Generator) -> None:
    """Catches an offset between videos of different scenes, and offsets of the other cameras that depend on a first
    camera with an unknown offset."""
    cameras = ring_cameras(4, SIZE)
    records = film_shifted(cameras, smooth_paths(rng, FRAMES + 20), (0, 10, 5, 0), rng)
    other = MotionRecord.of(film(cameras[0], smooth_paths(rng, FRAMES), rng))
    found = estimate_epipolar_offsets([other, *records[1:]], cameras, 300)
    assert found is not None
    assert max(found.confidence) < 0.5


def test_a_shorter_video_and_a_still_one(rng: np.random.Generator) -> None:
    """Catches correlations that need videos of equal lengths, and a division by zero where nothing moves."""
    cameras = ring_cameras(4, SIZE)
    paths = smooth_paths(rng, FRAMES)
    records = [MotionRecord.of(film(camera, paths, rng)) for camera in cameras]
    records[1] = MotionRecord.of(film(cameras[1], paths[15:], rng))
    still = np.full((SIZE, SIZE), 90, np.uint8)
    records[3] = MotionRecord.of([still] * FRAMES)
    found = estimate_epipolar_offsets(records, cameras, 300)
    assert found is not None
    np.testing.assert_allclose(found.subframes[1:3], (-15, 0), atol=1)
    assert found.confidence[3] == 0


def test_too_few_frames_or_cameras_give_no_offsets(rng: np.random.Generator) -> None:
    """Catches a crash for a short video or a single camera."""
    cameras = ring_cameras(2, SIZE)
    records = [MotionRecord.of(film(camera, smooth_paths(rng, 20), rng)) for camera in cameras]
    assert estimate_epipolar_offsets(records, cameras, 300) is None
    assert estimate_epipolar_offsets(records[:1], cameras[:1], 300) is None


def test_rigs_with_many_cameras_compare_only_some_pairs(rng: np.random.Generator) -> None:
    """Catches pairs of a camera with itself, and a camera that is compared with no other one."""
    cameras = ring_cameras(12, SIZE)
    offsets = tuple(int(o) for o in rng.integers(-10, 11, 12))
    found = estimate_epipolar_offsets(film_shifted(cameras, smooth_paths(rng, FRAMES + 21), offsets, rng), cameras, 40)
    assert found is not None
    np.testing.assert_allclose(found.subframes, np.subtract(offsets, offsets[0]), atol=1)


def test_a_point_has_the_same_plane_in_both_cameras(rng: np.random.Generator) -> None:
    """Catches planes with different angles in two cameras, also for cameras that see each other, with distorted lenses
    and with images of different sizes."""
    first, second = ring_cameras(2, SIZE)
    bent = replace(second, distortion=np.array([-0.2, 0.05, 0.001, -0.002, 0.0]))
    for other in (second.resize(60, 80), bent, ring_cameras(5, SIZE)[1]):
        planes = common_planes(first, other)
        assert planes is not None
        xyz = rng.uniform(-0.4, 0.4, (200, 3))
        groups = []
        for camera, numbers in zip((first, other), planes, strict=True):
            pixels, _ = camera.project(xyz)
            if camera.distortion is not None:
                turn, _ = cv2.Rodrigues(camera.rotation)
                pixels = cv2.projectPoints(xyz, turn, camera.translation, camera.intrinsics, camera.distortion)[0][:, 0]
            columns, rows = np.floor(pixels).astype(int).T
            groups.append(numbers.reshape(camera.height, camera.width)[rows, columns])
        known = (groups[0] < PLANES) & (groups[1] < PLANES)
        assert known.mean() > 0.9
        # Near the epipole, the planes of neighbouring pixels differ much.
        assert np.median(np.abs(groups[0] - groups[1])[known]) <= 1


def test_cameras_at_one_position_have_no_planes() -> None:
    """Catches a division by the distance 0 between two cameras."""
    first = ring_cameras(3, SIZE)[0]
    assert common_planes(first, first) is None


def test_correlations_equal_the_definition(rng: np.random.Generator) -> None:
    """Catches sums over wrong frames in the fast computation, and a wrong order of the lags."""
    first, second = rng.random((40, PLANES)), rng.random((55, PLANES))
    found = plane_correlations(first, second, 15)
    for lag, value in zip(range(-15, 16), found, strict=True):
        start, end = max(0, -lag), min(40, 55 - lag)
        x, y = first[start:end], second[start + lag : end + lag]
        x, y = x - x.mean(axis=0), y - y.mean(axis=0)
        assert value == pytest.approx((x * y).sum() / np.sqrt((x**2).sum() * (y**2).sum()), abs=1e-9)


def test_records_hold_the_energies_and_a_bounded_number_of_pixels(rng: np.random.Generator) -> None:
    """Catches motion energies that differ from those of motion_energy, and memory that grows with the moving area."""
    pictures = [rng.integers(0, 256, (300, 200)).astype(np.uint8) for _ in range(6)]
    record = MotionRecord.of(pictures)
    assert np.array_equal(record.energies, motion_energy(pictures))
    assert max(len(pixels) for pixels in record.pixels) <= MAX_PIXELS
    assert (record.width, record.height) == (100, 150)
