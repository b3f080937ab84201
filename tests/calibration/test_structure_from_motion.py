"""Cameras from pictures alone: true up to a similarity; a distance gives the unit, a chessboard the world."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.calibration.structure_from_motion import SelfCalibration, board_pose, calibrate, placed, scaled
from fourd.cameras import Camera, look_at
from fourd.errors import UserError
from tests.calibration.rooms import Room, room_cameras

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

NAMES = ("a/1", "b", "c", "d", "e")


@pytest.fixture(scope="module")
def truth() -> dict[str, Camera]:
    """Five cameras in a room, lenses with some barrel distortion."""
    cameras = room_cameras(len(NAMES), 400, 300, np.array([-0.06, 0, 0, 0.0]))
    return dict(zip(NAMES, cameras, strict=True))


@pytest.fixture(scope="module")
def pictures(truth: dict[str, Camera]) -> dict[str, list[Picture]]:
    """What they see."""
    room = Room(np.random.default_rng(3))
    return {name: [room.picture(camera)] for name, camera in truth.items()}


@pytest.fixture(scope="module")
def found(pictures: dict[str, list[Picture]]) -> SelfCalibration:
    """Their calibration from the pictures."""
    return calibrate(pictures, shared=True)


def _angle(first: Array, second: Array) -> float:
    """Degrees between two rotations."""
    return float(np.degrees(np.arccos(np.clip((np.trace(first @ second.T) - 1) / 2, -1, 1))))


@pytest.mark.slow
def test_the_cameras_are_true_up_to_a_similarity(truth: dict[str, Camera], found: SelfCalibration) -> None:
    """Catches a pose's inverse, another order of cameras, half pixels, and distortion of another meaning."""
    assert tuple(found.cameras) == NAMES
    assert found.missing == ()
    assert found.error_px < 0.8
    assert found.points > 100
    aligned = placed(found.cameras, truth)
    for name, camera in truth.items():
        assert np.linalg.norm(aligned[name].centre - camera.centre) < 0.03
        assert _angle(aligned[name].rotation, camera.rotation) < 0.6
        assert abs(aligned[name].intrinsics[0, 0] / camera.intrinsics[0, 0] - 1) < 0.02
        assert aligned[name].distortion is not None
        assert abs(aligned[name].distortion[0] + 0.06) < 0.03


@pytest.mark.slow
def test_the_same_pictures_give_the_same_cameras(pictures: dict[str, list[Picture]], found: SelfCalibration) -> None:
    """Catches a seed that does not reach RANSAC."""
    again = calibrate(pictures, shared=True)
    for name, camera in found.cameras.items():
        np.testing.assert_allclose(again.cameras[name].translation, camera.translation, atol=1e-3)
        np.testing.assert_allclose(again.cameras[name].intrinsics, camera.intrinsics, atol=0.05)


@pytest.mark.slow
def test_a_camera_that_sees_nothing_in_common_is_named(
    pictures: dict[str, list[Picture]], rng: np.random.Generator
) -> None:
    """Catches a camera that gets lost in silence, and good ones that are lost with it."""
    other = [cv2.GaussianBlur(rng.integers(0, 256, (300, 400, 3), dtype=np.uint8), (0, 0), 2)]
    with pytest.raises(UserError, match=r"expected pictures that match, got none for lost; give the cameras more ove"):
        calibrate({**pictures, "lost": other}, shared=True)


def test_pictures_without_texture_are_refused_in_one_line() -> None:
    """Catches a traceback from inside COLMAP."""
    blank = [np.full((80, 100, 3), 128, np.uint8)]
    with pytest.raises(UserError, match="got none for any camera") as error:
        calibrate(dict.fromkeys("abc", blank))
    assert "\n" not in str(error.value)


def test_arguments_out_of_range_are_named() -> None:
    """Catches work that begins before the arguments are looked at."""
    blank = np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(UserError, match="expected at least 3 to calibrate, got 2"):
        calibrate({"a": [blank], "b": [blank]})
    with pytest.raises(UserError, match="--shared: expected pictures of one size, got 8 x 8, 9 x 8"):
        calibrate({"a": [blank], "b": [blank], "c": [np.zeros((8, 9, 3), np.uint8)]}, shared=True)
    with pytest.raises(ValueError, match="as many frames of each camera"):
        calibrate({"a": [blank], "b": [blank, blank], "c": [blank]})


def test_a_known_distance_gives_the_unit(truth: dict[str, Camera]) -> None:
    """Catches a scale of the centres that leaves the translations, and a squared one."""
    cameras = scaled(truth, ("b", "e"), 10.0)
    assert np.linalg.norm(cameras["b"].centre - cameras["e"].centre) == pytest.approx(10)
    ratio = 10 / np.linalg.norm(truth["b"].centre - truth["e"].centre)
    np.testing.assert_allclose(cameras["c"].centre, ratio * truth["c"].centre)
    for pair, distance, words in ((("b", "x"), 1.0, "x: expected one of"), (("b", "b"), 1.0, "two cameras apart")):
        with pytest.raises(UserError, match=words):
            scaled(truth, pair, distance)
    with pytest.raises(UserError, match="got -1"):
        scaled(truth, ("b", "c"), -1.0)


def _board_picture(camera: Camera, columns: int, rows: int, square: float) -> Picture:
    """A chessboard on z = 0 on white: an inner corner at the origin, the others at x, y > 0, a black square there."""
    finer = 3
    u, v = (np.arange(camera.width * finer) + 0.5) / finer, (np.arange(camera.height * finer) + 0.5) / finer
    points = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    k = camera.intrinsics
    if camera.distortion is not None:
        points = cv2.undistortPoints(points, k, camera.distortion, R=None, P=k)
    rays = np.column_stack([points[:, 0], np.ones(len(points))]) @ np.linalg.inv(k).T @ camera.rotation
    distance = -camera.centre[2] / rays[:, 2]
    place = camera.centre + rays * distance[:, None]
    x, y = np.floor(place[:, 0] / square), np.floor(place[:, 1] / square)
    inside = (x >= -1) & (x < columns) & (y >= -1) & (y < rows) & (distance > 0)
    grey = np.where(inside & ((x + y) % 2 == 0), 20, 235).astype(np.uint8)
    whole = grey.reshape(camera.height * finer, camera.width * finer)
    small = cv2.resize(whole, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.repeat(np.asarray(small, np.uint8)[..., None], 3, axis=2)


def _over_board(angle: float, square: float) -> Camera:
    middle = np.array([3.5 * square, 2 * square, 0])
    centre = middle + 12 * square * np.array([0.6 * np.cos(angle), 0.6 * np.sin(angle), 0.8])
    intrinsics = np.array([[620.0, 0, 322], [0, 620, 236], [0, 0, 1]])
    camera = look_at(centre, middle, np.array([0.0, 0.0, 1.0]), intrinsics, 640, 480)
    return replace(camera, distortion=np.array([-0.05, 0.02, 0, 0]))


@pytest.mark.parametrize("angle", [0.3, 1.9, 3.6, 5.2])
def test_a_board_gives_the_pose_from_any_side(angle: float) -> None:
    """Catches a z into the board, half pixels, a lens that is not undone, and an origin that changes with the side."""
    square = 0.03
    camera = _over_board(angle, square)
    lens = Camera(camera.intrinsics, np.eye(3), np.zeros(3), 640, 480, camera.distortion)
    pose = board_pose(_board_picture(camera, 8, 5, square), lens, 8, 5, square)
    assert pose.centre[2] == pytest.approx(camera.centre[2], abs=0.001)
    assert np.linalg.norm(pose.centre - camera.centre) < 0.001
    assert _angle(pose.rotation, camera.rotation) < 0.2


def test_a_picture_without_a_board_is_refused() -> None:
    """Catches a pose from nothing, and counts that cannot be."""
    lens = _over_board(0.3, 0.03)
    with pytest.raises(UserError, match="expected a chessboard of 8 x 5 inner corners, got none"):
        board_pose(np.full((480, 640, 3), 200, np.uint8), lens, 8, 5, 0.03)
    with pytest.raises(UserError, match="at least 3 x 3 inner corners"):
        board_pose(np.full((480, 640, 3), 200, np.uint8), lens, 8, 2, 0.03)


def test_cameras_follow_the_ones_whose_pose_is_known(truth: dict[str, Camera], rng: np.random.Generator) -> None:
    """Catches a similarity that is applied the wrong way round; with one pose the unit must stay."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    shift, scale = rng.normal(size=3), 2.5
    moved = {}
    for name, camera in truth.items():
        rotation = camera.rotation @ turn.T
        centre = scale * turn @ camera.centre + shift
        moved[name] = replace(camera, rotation=rotation, translation=-rotation @ centre)
    back = placed(moved, {name: truth[name] for name in ("b", "d")})
    for name, camera in truth.items():
        np.testing.assert_allclose(back[name].centre, camera.centre, atol=1e-9)
        np.testing.assert_allclose(back[name].rotation, camera.rotation, atol=1e-9)
    one = placed(moved, {"c": truth["c"]})
    np.testing.assert_allclose(one["c"].centre, truth["c"].centre, atol=1e-9)
    assert np.linalg.norm(one["a/1"].centre - one["c"].centre) == pytest.approx(
        scale * np.linalg.norm(truth["a/1"].centre - truth["c"].centre)
    )
    with pytest.raises(UserError, match="a calibrated camera, got none"):
        placed(moved, {"x": truth["c"]})
