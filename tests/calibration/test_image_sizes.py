"""Hypotheses of how images were resized, and mirrored principal points. The data are synthetic images and a real
recording."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.calibration.image_sizes import Borders, choose_size, measure_black_borders, size_hypotheses
from fourd.recording.calibration.matching import Matches, distort_points
from fourd.recording.calibration.plane_matching import PlanePatch, match_on_plane
from fourd.recording.calibration.principal_points import choose_principal_points, principal_point_hypotheses
from fourd.recording.calibration.residuals import Pair, epipolar_distances
from fourd.recording.importing.formats.qualisys import read_cameras
from tests.calibration.rooms import Room, room_cameras

BALANCE = Path(__file__).parents[2].parent / "shared" / "captures" / "balance"
Picture = NDArray[np.uint8]


def _project_to_matches(rng: np.random.Generator, cameras: list[Camera]) -> dict[Pair, Matches]:
    """Projections of random points into all pairs of images, with 0.1 px of noise."""
    xyz = rng.uniform((0.7, 0.7, 0.1), (1.9, 1.9, 1.3), (200, 3))
    seen = [distort_points(camera, camera.project(xyz)[0]) + rng.normal(0, 0.1, (200, 2)) for camera in cameras]
    return {(i, j): Matches(seen[i], seen[j]) for i, j in combinations(range(len(cameras)), 2)}


def _off_centre_cameras() -> list[Camera]:
    """Four cameras with distortion and principal points off the centre."""
    cameras = room_cameras(4, 1088, 1920, np.array([-0.05, 0.02, 0.001, 0.0, 0.0]))
    shift = np.array([[0, 0, 11.0], [0, 0, -14.0], [0, 0, 0]])
    return [replace(camera, intrinsics=camera.intrinsics + shift * (1 + index)) for index, camera in enumerate(cameras)]


def test_hypotheses_fit_the_sizes() -> None:
    """Catches a letterbox hypothesis for equal aspect ratios, and a crop hypothesis for a larger image."""
    camera = _off_centre_cameras()[0]
    assert list(size_hypotheses(camera, 1088, 1920)) == ["unchanged"]
    assert list(size_hypotheses(camera, 544, 960)) == ["scaled", "cropped centre"]
    assert set(size_hypotheses(camera, 1080, 1920)) == {
        "stretched", "letterboxed", "cropped centre", "cropped left", "cropped right"
    }  # fmt: skip
    assert "cropped top" in size_hypotheses(camera, 1088, 1900)
    assert set(size_hypotheses(camera, 2000, 1920)) == {"stretched", "letterboxed", "filled"}


def test_hypotheses_move_the_principal_point_with_the_pixels() -> None:
    """Catches a principal point that is shifted to the wrong side, and black bars on only one side."""
    camera = _off_centre_cameras()[0]
    middle = camera.intrinsics[:2, 2]
    found = {name: camera.intrinsics[:2, 2] for name, camera in size_hypotheses(camera, 1080, 1920).items()}
    scale = 1080 / 1088
    np.testing.assert_allclose(found["stretched"], middle * [scale, 1])
    np.testing.assert_allclose(found["cropped left"], middle - [8, 0])
    np.testing.assert_allclose(found["cropped right"], middle)
    np.testing.assert_allclose(found["cropped centre"], middle - [4, 0])
    np.testing.assert_allclose(found["letterboxed"], middle * scale + [0, (1920 - 1920 * scale) / 2])


@pytest.mark.parametrize("name", ["stretched", "letterboxed", "cropped left", "cropped right", "cropped centre"])
def test_residuals_alone_choose_the_true_hypothesis(rng: np.random.Generator, name: str) -> None:
    """Catches scores that confuse cameras, and unclear evidence that is reported as clear."""
    cameras = _off_centre_cameras()
    true = [size_hypotheses(camera, 1080, 1920)[name] if index < 2 else camera for index, camera in enumerate(cameras)]
    sizes = [(camera.width, camera.height) for camera in true]
    choice = choose_size(_project_to_matches(rng, true), cameras, sizes)
    assert choice.name == name
    # At the positions of the test points, stretching by 8 pixels hardly differs from cropping 4 pixels on each side.
    assert choice.is_clear or name in ("stretched", "cropped centre")
    assert f"{name}: 0." in choice.why
    for camera, expected in zip(choice.cameras, true, strict=True):
        np.testing.assert_allclose(camera.intrinsics, expected.intrinsics)


def test_borders_decide_without_matches(rng: np.random.Generator) -> None:
    """Catches a hypothesis that is reported as clear without evidence."""
    cameras = _off_centre_cameras()
    sizes = [(1080, 1920), (1088, 1920), (1088, 1920), (1088, 1920)]
    unknown = choose_size({}, cameras, sizes)
    assert not unknown.is_clear
    boxed = choose_size({}, cameras, sizes, {0: Borders(0, 7.1, 0, 7.0)})
    assert (boxed.name, boxed.is_clear) == ("letterboxed", True)
    assert choose_size({}, cameras, sizes, {0: Borders(0, 0, 0, 0)}).name != "letterboxed"
    with pytest.raises(ValueError, match="got none"):
        choose_size({}, cameras, [(1088, 1920)] * 4)


def test_borders_that_contradict_the_matches_are_not_clear(rng: np.random.Generator) -> None:
    """Catches a dark edge of the scene that is taken for a black border, although the matches show stretching."""
    cameras = _off_centre_cameras()
    true = [
        size_hypotheses(camera, 1080, 1920)["stretched"] if index < 2 else camera
        for index, camera in enumerate(cameras)
    ]
    sizes = [(camera.width, camera.height) for camera in true]
    choice = choose_size(_project_to_matches(rng, true), cameras, sizes, {0: Borders(0, 7.1, 0, 7.0)})
    assert choice.name == "letterboxed"
    assert choice.residuals["letterboxed"] is not None
    assert not choice.is_clear


@pytest.mark.parametrize("bar", [0.0, 3.0, 7.06, 12.5])
def test_black_borders_have_subpixel_accuracy(rng: np.random.Generator, bar: float) -> None:
    """Catches a partly covered row that counts as a full row. Also catches noise or dark images that are measured as
    borders."""
    camera = room_cameras(1, 240, 320)[0]
    scene = Room(rng).picture(camera, oversampling=1)
    scene = (scene // 2 + 100).astype(np.uint8)
    shrink = np.array([[1, 0, 0], [0, (320 - 2 * bar) / 320, bar]])
    finer = cv2.resize(scene, None, fx=1, fy=16, interpolation=cv2.INTER_NEAREST)
    shrink[1, 2] *= 16
    made = cv2.warpAffine(finer, shrink, (240, 320 * 16))
    made = cv2.resize(made, (240, 320), interpolation=cv2.INTER_AREA)
    noisy = np.clip(made + rng.normal(0, 2, made.shape), 0, 255).astype(np.uint8)
    found = measure_black_borders([noisy])
    assert found.max_difference(Borders(0, bar, 0, bar)) < 0.35


def test_mirrored_principal_points_are_found(rng: np.random.Generator) -> None:
    """Catches a search that mirrors the principal points of all cameras along the same axis, and a correct calibration
    that is reported as mirrored.
    """
    cameras = _off_centre_cameras()
    matches = _project_to_matches(rng, cameras)
    fine = choose_principal_points(matches, cameras)
    assert set(fine.names) == {"as given"}
    assert fine.is_clear
    names = ("mirrored x", "mirrored y", "as given", "mirrored both")
    wrong = [principal_point_hypotheses(camera)[name] for camera, name in zip(cameras, names, strict=True)]
    found = choose_principal_points(matches, wrong)
    assert found.names == names
    assert found.is_clear
    assert found.given_px > 5 > 1 > found.chosen_px
    with pytest.raises(ValueError, match="at most 5, got 8"):
        choose_principal_points(matches, cameras * 2)


def test_matches_on_a_plane_do_not_follow_a_wrong_calibration() -> None:
    """Catches a matching search that merely returns the positions that the calibration predicts."""
    true = room_cameras(4, 640, 480, np.array([-0.08, 0.02, 0, 0]))
    room = Room(np.random.default_rng(2))
    pictures = [room.picture(true[index]) for index in (0, 3)]
    shift = np.array([[0, 0, 4.0], [0, 0, -5.0], [0, 0, 0]])
    wrong = replace(true[3], intrinsics=true[3].intrinsics + shift)
    floor = PlanePatch(np.array([0.2, 1.8, 0]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), 1.6, 1.6, 250)
    found = match_on_plane(pictures[0], pictures[1], (true[0], wrong), floor)
    assert len(found) >= 10
    assert np.median(np.abs(epipolar_distances(found, true[0], true[3]))) < 0.5
    assert np.median(np.abs(epipolar_distances(found, true[0], wrong))) > 2


@pytest.mark.slow
def test_real_recording_is_letterboxed_and_mirrored() -> None:
    """Catches wrong hypotheses for a real recording, whose images of 1080 px width are letterboxed and whose rotated
    cameras are mirrored."""
    if not BALANCE.is_dir():
        pytest.skip(f"no real capture at {BALANCE}")
    cameras = list(read_cameras(BALANCE / "Calib.qca.txt").values())
    pictures = []
    for path in sorted(BALANCE.glob("*.mp4")):
        with av.open(str(path)) as video:
            pictures.append(next(video.decode(video=0)).to_ndarray(format="rgb24"))
    sizes = [picture.shape[1::-1] for picture in pictures]
    borders = {index: measure_black_borders([pictures[index]]) for index in (0, 1)}
    for found in borders.values():
        assert found.max_difference(Borders(0, 7.06, 0, 7.06)) < 0.5
    boxed = [size_hypotheses(camera, *size) for camera, size in zip(cameras, sizes, strict=True)]
    start = [found.get("letterboxed", camera) for found, camera in zip(boxed, cameras, strict=True)]
    # According to the calibration, the treadmill's top is within 2 cm of z = 0.
    top = PlanePatch(np.array([-2.6, 1.3, 0]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), 3.5, 2.6, 400)
    matches = {
        (i, j): match_on_plane(pictures[i], pictures[j], (start[i], start[j]), top)
        for i, j in combinations(range(4), 2)
    }
    assert min(map(len, matches.values())) >= 8
    centres = choose_principal_points(matches, start)
    assert centres.names == ("mirrored x", "mirrored y", "mirrored y", "mirrored y")
    assert centres.is_clear
    assert centres.given_px > 10
    assert centres.chosen_px < 1
    corrected = [principal_point_hypotheses(camera)[name] for camera, name in zip(cameras, centres.names, strict=True)]
    by_residuals = choose_size(matches, corrected, sizes)
    assert by_residuals.name == "letterboxed"
    both = choose_size(matches, corrected, sizes, borders)
    assert (both.name, both.is_clear) == ("letterboxed", True)
