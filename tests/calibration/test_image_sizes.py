"""How pictures came to another size, and principal points on the wrong side: synthetic, and the real recording."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.calibration.image_sizes import Borders, black_borders, pick_size, size_hypotheses
from fourd.calibration.matching import Matches, distorted
from fourd.calibration.plane_matching import Patch, flat_matches
from fourd.calibration.principal_points import pick_centres, principal_point_hypotheses
from fourd.calibration.residuals import Pair, epipolar_distances
from fourd.cameras import Camera
from fourd.importing.formats.qualisys import read_lenses
from tests.calibration.rooms import Room, room_cameras

BALANCE = Path(__file__).parents[2].parent / "shared" / "captures" / "balance"
Picture = NDArray[np.uint8]


def _matches(rng: np.random.Generator, cameras: list[Camera]) -> dict[Pair, Matches]:
    """Places of random points in all pairs of pictures, to 0.1 px."""
    xyz = rng.uniform((0.7, 0.7, 0.1), (1.9, 1.9, 1.3), (200, 3))
    seen = [distorted(camera, camera.project(xyz)[0]) + rng.normal(0, 0.1, (200, 2)) for camera in cameras]
    return {(i, j): Matches(seen[i], seen[j]) for i, j in combinations(range(len(cameras)), 2)}


def _lenses() -> list[Camera]:
    lenses = room_cameras(4, 1088, 1920, np.array([-0.05, 0.02, 0.001, 0.0, 0.0]))
    shift = np.array([[0, 0, 11.0], [0, 0, -14.0], [0, 0, 0]])
    return [replace(lens, intrinsics=lens.intrinsics + shift * (1 + index)) for index, lens in enumerate(lenses)]


def test_the_hypotheses_that_make_sense_are_named() -> None:
    """Catches a letterbox for equal shapes and a crop to more than there is."""
    lens = _lenses()[0]
    assert list(size_hypotheses(lens, 1088, 1920)) == ["unchanged"]
    assert list(size_hypotheses(lens, 544, 960)) == ["scaled", "cropped centre"]
    assert set(size_hypotheses(lens, 1080, 1920)) == {
        "stretched", "letterboxed", "cropped centre", "cropped left", "cropped right"
    }  # fmt: skip
    assert "cropped top" in size_hypotheses(lens, 1088, 1900)
    assert set(size_hypotheses(lens, 2000, 1920)) == {"stretched", "letterboxed", "filled"}


def test_a_hypothesis_moves_the_same_pixels_as_the_pictures() -> None:
    """Catches a shift to the wrong side and bars that are not halved."""
    lens = _lenses()[0]
    middle = lens.intrinsics[:2, 2]
    found = {name: camera.intrinsics[:2, 2] for name, camera in size_hypotheses(lens, 1080, 1920).items()}
    scale = 1080 / 1088
    np.testing.assert_allclose(found["stretched"], middle * [scale, 1])
    np.testing.assert_allclose(found["cropped left"], middle - [8, 0])
    np.testing.assert_allclose(found["cropped right"], middle)
    np.testing.assert_allclose(found["cropped centre"], middle - [4, 0])
    np.testing.assert_allclose(found["letterboxed"], middle * scale + [0, (1920 - 1920 * scale) / 2])


@pytest.mark.parametrize("name", ["stretched", "letterboxed", "cropped left", "cropped right", "cropped centre"])
def test_the_true_hypothesis_is_picked_by_residuals_alone(rng: np.random.Generator, name: str) -> None:
    """Catches scores that mix up cameras, and evidence called clear that is not."""
    lenses = _lenses()
    true = [size_hypotheses(lens, 1080, 1920)[name] if index < 2 else lens for index, lens in enumerate(lenses)]
    sizes = [(camera.width, camera.height) for camera in true]
    choice = pick_size(_matches(rng, true), lenses, sizes)
    assert choice.name == name
    # A stretch by 8 pixels and a crop of 4 on either side hardly differ where the points are, and it says so.
    assert choice.is_clear or name in ("stretched", "cropped centre")
    assert f"{name}: 0." in choice.why
    for camera, expected in zip(choice.lenses, true, strict=True):
        np.testing.assert_allclose(camera.intrinsics, expected.intrinsics)


def test_borders_decide_where_there_are_no_matches(rng: np.random.Generator) -> None:
    """Catches a choice that is called clear without evidence."""
    lenses = _lenses()
    sizes = [(1080, 1920), (1088, 1920), (1088, 1920), (1088, 1920)]
    unknown = pick_size({}, lenses, sizes)
    assert not unknown.is_clear
    boxed = pick_size({}, lenses, sizes, {0: Borders(0, 7.1, 0, 7.0)})
    assert (boxed.name, boxed.is_clear) == ("letterboxed", True)
    assert pick_size({}, lenses, sizes, {0: Borders(0, 0, 0, 0)}).name != "letterboxed"
    with pytest.raises(ValueError, match="got none"):
        pick_size({}, lenses, [(1088, 1920)] * 4)


@pytest.mark.parametrize("bar", [0.0, 3.0, 7.06, 12.5])
def test_black_borders_are_measured_to_a_fraction(rng: np.random.Generator, bar: float) -> None:
    """Catches a mixture row that counts whole, and noise or dark pictures that are taken for borders."""
    camera = room_cameras(1, 240, 320)[0]
    scene = Room(rng).picture(camera, finer=1)
    scene = (scene // 2 + 100).astype(np.uint8)
    shrink = np.array([[1, 0, 0], [0, (320 - 2 * bar) / 320, bar]])
    finer = cv2.resize(scene, None, fx=1, fy=16, interpolation=cv2.INTER_NEAREST)
    shrink[1, 2] *= 16
    made = cv2.warpAffine(finer, shrink, (240, 320 * 16))
    made = cv2.resize(made, (240, 320), interpolation=cv2.INTER_AREA)
    noisy = np.clip(made + rng.normal(0, 2, made.shape), 0, 255).astype(np.uint8)
    found = black_borders([noisy])
    assert found.difference(Borders(0, bar, 0, bar)) < 0.35


def test_mirrored_principal_points_are_found(rng: np.random.Generator) -> None:
    """Catches one rule for all cameras, and a good calibration that is called mirrored."""
    lenses = _lenses()
    matches = _matches(rng, lenses)
    fine = pick_centres(matches, lenses)
    assert set(fine.names) == {"as given"}
    assert fine.is_clear
    names = ("mirrored x", "mirrored y", "as given", "mirrored both")
    wrong = [principal_point_hypotheses(lens)[name] for lens, name in zip(lenses, names, strict=True)]
    found = pick_centres(matches, wrong)
    assert found.names == names
    assert found.is_clear
    assert found.given_px > 5 > 1 > found.chosen_px
    with pytest.raises(ValueError, match="at most 5 cameras"):
        pick_centres(matches, lenses * 2)


def test_matches_on_a_plane_are_true_though_the_calibration_is_not() -> None:
    """Catches a search that returns the place where it began."""
    true = room_cameras(4, 640, 480, np.array([-0.08, 0.02, 0, 0]))
    room = Room(np.random.default_rng(2))
    pictures = [room.picture(true[index]) for index in (0, 3)]
    shift = np.array([[0, 0, 4.0], [0, 0, -5.0], [0, 0, 0]])
    wrong = replace(true[3], intrinsics=true[3].intrinsics + shift)
    floor = Patch(np.array([0.2, 1.8, 0]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), 1.6, 1.6, 250)
    found = flat_matches(pictures[0], pictures[1], (true[0], wrong), floor)
    assert len(found) >= 10
    assert np.median(np.abs(epipolar_distances(found, true[0], true[3]))) < 0.5
    assert np.median(np.abs(epipolar_distances(found, true[0], wrong))) > 2


@pytest.mark.slow
def test_the_real_recording_was_letterboxed_and_its_calibration_mirrored() -> None:
    """The finding about balance: 1080 wide pictures are letterboxed, and turned cameras' centres are mirrored."""
    if not BALANCE.is_dir():
        pytest.skip(f"no real capture at {BALANCE}")
    lenses = list(read_lenses(BALANCE / "Calib.qca.txt").values())
    pictures = []
    for path in sorted(BALANCE.glob("*.mp4")):
        with av.open(str(path)) as video:
            pictures.append(next(video.decode(video=0)).to_ndarray(format="rgb24"))
    sizes = [picture.shape[1::-1] for picture in pictures]
    borders = {index: black_borders([pictures[index]]) for index in (0, 1)}
    for found in borders.values():
        assert found.difference(Borders(0, 7.06, 0, 7.06)) < 0.5
    boxed = [size_hypotheses(lens, *size) for lens, size in zip(lenses, sizes, strict=True)]
    start = [found.get("letterboxed", lens) for found, lens in zip(boxed, lenses, strict=True)]
    # The treadmill's top, by the calibration about 2 cm around z = 0.
    top = Patch(np.array([-2.6, 1.3, 0]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), 3.5, 2.6, 400)
    matches = {
        (i, j): flat_matches(pictures[i], pictures[j], (start[i], start[j]), top) for i, j in combinations(range(4), 2)
    }
    assert min(map(len, matches.values())) >= 8
    centres = pick_centres(matches, start)
    assert centres.names == ("mirrored x", "mirrored y", "mirrored y", "mirrored y")
    assert centres.is_clear
    assert centres.given_px > 10
    assert centres.chosen_px < 1
    mended = [principal_point_hypotheses(lens)[name] for lens, name in zip(lenses, centres.names, strict=True)]
    by_residuals = pick_size(matches, mended, sizes)
    assert by_residuals.name == "letterboxed"
    both = pick_size(matches, mended, sizes, borders)
    assert (both.name, both.is_clear) == ("letterboxed", True)
