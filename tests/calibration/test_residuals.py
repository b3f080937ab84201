"""Epipolar residuals: small for a true calibration, large for a wrong camera, and None if there are no matches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.calibration.matching import (
    Matches,
    distort_points,
    extract_features,
    inlier_mask,
    match_positions,
    undistort_points,
)
from fourd.recording.calibration.residuals import (
    compute_residuals,
    epipolar_distances,
    epipolar_residuals,
    find_bad_cameras,
    match_pairs,
    select_pairs,
)
from fourd.recording.capture import open_capture
from tests.calibration.rooms import Room, room_cameras
from tests.captures import ring_cameras

CAPTURES = Path(__file__).parents[2].parent / "shared" / "captures"
Picture = NDArray[np.uint8]
DISTORTION = np.array([-0.12, 0.05, 0.001, -0.001, 0.0])


def _rotate(camera: Camera, degrees: float) -> Camera:
    """A camera rotated about its centre."""
    turn = np.asarray(cv2.Rodrigues(np.radians([degrees, -degrees / 2, 0.0]))[0])
    return replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation)


@pytest.fixture(scope="module")
def room() -> tuple[list[Camera], list[Picture]]:
    """Six cameras with distortion, and their images."""
    cameras = room_cameras(6, distortion=DISTORTION)
    textured = Room(np.random.default_rng(5))
    return cameras, [textured.picture(camera) for camera in cameras]


def test_true_calibration_has_subpixel_residuals(room: tuple[list[Camera], list[Picture]]) -> None:
    """Catches half-pixel shifts between OpenCV's features and the cameras, and ignored distortion."""
    cameras, pictures = room
    found = epipolar_residuals(pictures, cameras)
    assert len(found.pairs) >= 10
    assert max(found.pairs.values()) < 0.35
    assert found.bad == ()
    assert all(residual is not None and residual < 0.35 for residual in found.cameras)


def test_only_the_bad_camera_is_named(room: tuple[list[Camera], list[Picture]]) -> None:
    """Catches residuals that are attributed to the neighbours of a bad camera, and matches that are filtered with the
    calibration under test."""
    cameras, pictures = room
    matches = match_pairs(pictures, cameras)
    for bad in range(len(cameras)):
        wrong = [_rotate(camera, 2) if index == bad else camera for index, camera in enumerate(cameras)]
        found = compute_residuals(matches, wrong)
        assert found.bad == (bad,)
        residuals = [residual or 0 for residual in found.cameras]
        assert int(np.argmax(residuals)) == bad
        assert residuals[bad] > 3
        assert max(value for index, value in enumerate(residuals) if index != bad) < 1


def test_matches_do_not_depend_on_the_poses(room: tuple[list[Camera], list[Picture]]) -> None:
    """Catches a filter that keeps only the matches that fit a wrong calibration."""
    cameras, pictures = room
    wrong = [_rotate(camera, 2) if index == 2 else camera for index, camera in enumerate(cameras)]
    true, other = match_pairs(pictures, cameras), match_pairs(pictures, wrong)
    assert {pair: len(found) for pair, found in true.items()} == {pair: len(found) for pair, found in other.items()}


def test_pictures_without_texture_have_no_residuals() -> None:
    """Catches residuals that are computed from too few matches."""
    cameras = room_cameras(3)
    found = epipolar_residuals([np.full((360, 480, 3), 90, np.uint8)] * 3, cameras)
    assert found.pairs == {}
    assert found.cameras == (None, None, None)
    assert found.bad == ()


def test_pictures_of_different_scenes_do_not_match(rng: np.random.Generator) -> None:
    """Catches a fundamental matrix fitted to random matches."""
    cameras = room_cameras(4)
    pictures = [Room(rng).picture(camera, oversampling=1) for camera in cameras]
    assert epipolar_residuals(pictures, cameras).pairs == {}


def test_verification_separates_true_from_random_matches(rng: np.random.Generator) -> None:
    """Catches inlier thresholds that random matches also reach, such as a share or a number of inliers."""
    cameras = room_cameras(2, 1000, 800)
    chance = Matches(rng.uniform(0, 800, (200, 2)), rng.uniform(0, 800, (200, 2)))
    assert not inlier_mask(chance, 1000, 800).any()
    xyz = rng.uniform((0.8, 0.8, 0.2), (1.6, 1.6, 1.2), (120, 3))
    first, second = (camera.project(xyz)[0] + rng.normal(0, 0.3, (120, 2)) for camera in cameras)
    mixed = Matches(np.vstack([first, chance.first_px]), np.vstack([second, chance.second_px]))
    kept = inlier_mask(mixed, 1000, 800)
    assert kept[:120].mean() > 0.9
    assert kept[120:].mean() < 0.1


def test_planar_scene_keeps_the_matches_on_the_plane_alone(rng: np.random.Generator) -> None:
    """Catches the degenerate fundamental matrix of a planar scene, which also fits any two matches off the plane."""
    cameras = room_cameras(2, 1000, 800)
    xyz = np.column_stack([rng.uniform((0.6, 0.6), (1.8, 1.8), (100, 2)), np.full(100, 0.4)])
    first, second = (camera.project(xyz)[0] + rng.normal(0, 0.2, (100, 2)) for camera in cameras)
    wrong = rng.uniform(0, 800, (30, 4))
    mixed = Matches(np.vstack([first, wrong[:, :2]]), np.vstack([second, wrong[:, 2:]]))
    kept = inlier_mask(mixed, 1000, 800)
    assert kept[:100].mean() > 0.95
    assert kept[100:].sum() <= 1


def test_matches_without_a_valid_sample_have_no_inliers() -> None:
    """Catches the assertion !model.empty() of OpenCV 5, which ended fourd check on ordinary captures.

    The nine matches are those of two cameras of a synthetic capture. All of them are wrong, and no sample of them gives
    a fundamental matrix.
    """
    first = [(83.8, 71.9), (85.5, 64.7), (90.4, 32.4), (110.3, 140.9), (112.3, 155.9), (113.5, 123.5), (117.8, 129.0)]
    second = [(86.7, 65.1), (88.0, 58.4), (87.3, 36.4), (116.0, 134.8), (120.4, 148.7), (112.3, 117.1), (116.4, 118.5)]
    first, second = [*first, (118.3, 162.8), (120.6, 60.0)], [*second, (88.0, 62.1), (113.9, 59.0)]
    assert not inlier_mask(Matches(np.array(first), np.array(second)), 192, 192).any()


def test_distances_are_perpendicular_to_the_line(rng: np.random.Generator) -> None:
    """Catches epipolar distances with a wrong scale, and distances that include shifts along the epipolar line."""
    near = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])
    left = Camera(near, np.eye(3), np.zeros(3), 640, 480)
    right = Camera(near, np.eye(3), np.array([-0.5, 0, 0]), 640, 480)
    xyz = rng.uniform((-0.5, -0.5, 2), (0.5, 0.5, 4), (50, 3))
    matches = Matches(left.project(xyz)[0], right.project(xyz)[0])
    np.testing.assert_allclose(epipolar_distances(matches, left, right), 0, atol=1e-9)
    up = Matches(matches.first_px, matches.second_px + np.array([7.0, 2.5]))
    np.testing.assert_allclose(np.abs(epipolar_distances(up, left, right)), 2.5, atol=1e-9)
    assert not epipolar_distances(up, left, left).any()


def test_distortion_round_trip(rng: np.random.Generator) -> None:
    """Catches undistortion with too few iterations, and OpenCV's half-pixel offset."""
    camera = room_cameras(1, distortion=DISTORTION)[0]
    xy = rng.uniform((0, 0), (480, 360), (200, 2))
    np.testing.assert_allclose(distort_points(camera, undistort_points(camera, xy)), xy, atol=1e-6)
    np.testing.assert_allclose(undistort_points(camera, camera.intrinsics[:2, 2][None]), camera.intrinsics[None, :2, 2])


def test_no_camera_is_bad_without_enough_evidence() -> None:
    """Catches a camera reported as bad if there are only two cameras or if all pairs disagree."""
    assert find_bad_cameras({(0, 1): 50.0}) == ()
    assert find_bad_cameras({(0, 1): 50.0, (0, 2): 60.0, (1, 2): 40.0}) == ()
    assert find_bad_cameras({(0, 1): 0.5, (0, 2): 60.0}) == ()
    assert find_bad_cameras({(0, 1): 0.5, (0, 2): 2.9, (1, 2): 2.9}) == ()
    assert find_bad_cameras({(0, 1): 0.5, (0, 2): 60.0, (1, 2): 40.0, (0, 3): 0.4, (1, 3): 0.6, (2, 3): 30.0}) == (2,)


def test_neighbours_in_a_ring_are_paired() -> None:
    """Catches pairs of cameras on opposite sides of a ring, which see no common surface. Also catches a missing pair of
    the first and last camera."""
    pairs = select_pairs(ring_cameras(20, 64))
    assert all(min((j - i) % 20, (i - j) % 20) <= 4 for i, j in pairs)
    assert (0, 19) in pairs
    assert len(select_pairs(ring_cameras(8, 64))) == 28


def test_pictures_of_another_size_are_refused() -> None:
    """Catches residuals computed for images that do not have their camera's size."""
    cameras = room_cameras(2)
    with pytest.raises(ValueError, match=r"pictures\[1\]: expected 360 x 480 x 3"):
        match_pairs([np.zeros((360, 480, 3), np.uint8), np.zeros((360, 470, 3), np.uint8)], cameras)


def test_features_with_several_orientations_match_once(room: tuple[list[Camera], list[Picture]]) -> None:
    """Catches duplicate matches at one position that count as evidence."""
    _, pictures = room
    found = extract_features(pictures[0])
    both = match_positions(found, found)
    assert len(np.unique(np.round(both.first_px), axis=0)) == len(both) > 100


@pytest.mark.slow
def test_real_ring_has_no_bad_camera_until_one_is_rotated() -> None:
    """Catches false alarms in captures with tiles and bare walls, and bad cameras that are not found in such
    captures."""
    if not (CAPTURES / "fox_run").is_dir():
        pytest.skip(f"no real capture at {CAPTURES / 'fox_run'}")
    capture = open_capture(CAPTURES / "fox_run")
    pictures = [capture.image(camera, 0) for camera in range(len(capture.names))]
    matches = match_pairs(pictures, capture.cameras)
    found = compute_residuals(matches, capture.cameras)
    assert found.bad == ()
    assert len(found.pairs) >= 12
    assert np.median(list(found.pairs.values())) < 0.6
    wrong = [_rotate(camera, 0.6) if index == 13 else camera for index, camera in enumerate(capture.cameras)]
    assert compute_residuals(matches, wrong).bad == (13,)
