"""Calibration from images alone. A given distance determines the scale, and a chessboard determines the world frame."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.base.errors import UserError
from fourd.recording.calibration.chessboard import Board, board_pose
from fourd.recording.calibration.scale import Distance, align_cameras, scale_cameras
from fourd.recording.calibration.structure_from_motion import SelfCalibration, calibrate_from_pictures
from tests.calibration.rooms import Room, room_cameras

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

NAMES = ("a/1", "b", "c", "d", "e")


@pytest.fixture(scope="module")
def truth() -> dict[str, Camera]:
    """Five cameras in a room, with barrel distortion."""
    cameras = room_cameras(len(NAMES), 400, 300, np.array([-0.06, 0, 0, 0.0]))
    return dict(zip(NAMES, cameras, strict=True))


@pytest.fixture(scope="module")
def pictures(truth: dict[str, Camera]) -> dict[str, list[Picture]]:
    """One image per camera of the room."""
    room = Room(np.random.default_rng(3))
    return {name: [room.picture(camera)] for name, camera in truth.items()}


@pytest.fixture(scope="module")
def found(pictures: dict[str, list[Picture]]) -> SelfCalibration:
    """The calibration that is estimated from the images."""
    return calibrate_from_pictures(pictures, is_lens_shared=True)


def _angle(first: Array, second: Array) -> float:
    """Angle between two rotations in degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(first @ second.T) - 1) / 2, -1, 1))))


@pytest.mark.slow
def test_cameras_are_true_up_to_a_similarity(truth: dict[str, Camera], found: SelfCalibration) -> None:
    """Catches inverted poses, a changed order of cameras, half-pixel offsets, and distortion in another convention."""
    assert tuple(found.cameras) == NAMES
    assert found.missing == ()
    assert found.error_px < 0.8
    assert found.points > 100
    aligned = align_cameras(found.cameras, truth)
    for name, camera in truth.items():
        assert np.linalg.norm(aligned[name].centre - camera.centre) < 0.03
        assert _angle(aligned[name].rotation, camera.rotation) < 0.6
        assert abs(aligned[name].intrinsics[0, 0] / camera.intrinsics[0, 0] - 1) < 0.02
        assert aligned[name].distortion is not None
        assert abs(aligned[name].distortion[0] + 0.06) < 0.03


@pytest.mark.slow
def test_same_pictures_give_the_same_cameras(pictures: dict[str, list[Picture]], found: SelfCalibration) -> None:
    """Catches a random seed that is not passed on to RANSAC."""
    again = calibrate_from_pictures(pictures, is_lens_shared=True)
    for name, camera in found.cameras.items():
        np.testing.assert_allclose(again.cameras[name].translation, camera.translation, atol=1e-3)
        np.testing.assert_allclose(again.cameras[name].intrinsics, camera.intrinsics, atol=0.05)


@pytest.mark.slow
def test_unmatched_camera_is_named(pictures: dict[str, list[Picture]], rng: np.random.Generator) -> None:
    """Catches an unusable camera that is dropped without an error, and valid cameras that are dropped together with
    it."""
    other = [cv2.GaussianBlur(rng.integers(0, 256, (300, 400, 3), dtype=np.uint8), (0, 0), 2)]
    with pytest.raises(
        UserError, match=r"expected images with enough matches, got too few for lost; give the cameras more ove"
    ):
        calibrate_from_pictures({**pictures, "lost": other}, is_lens_shared=True)


def test_pictures_without_texture_are_refused() -> None:
    """Catches a traceback from COLMAP."""
    blank = [np.full((80, 100, 3), 128, np.uint8)]
    with pytest.raises(UserError, match="got too few for any camera") as error:
        calibrate_from_pictures(dict.fromkeys("abc", blank))
    assert "\n" not in str(error.value)


def test_arguments_are_checked_first() -> None:
    """Catches work that starts before the arguments are checked."""
    blank = np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(UserError, match="expected at least 3 for calibration, got 2"):
        calibrate_from_pictures({"a": [blank], "b": [blank]})
    with pytest.raises(UserError, match="shared lens: expected images of one size, got 8 x 8, 9 x 8"):
        calibrate_from_pictures({"a": [blank], "b": [blank], "c": [np.zeros((8, 9, 3), np.uint8)]}, is_lens_shared=True)
    with pytest.raises(ValueError, match="the same number of frames for each camera"):
        calibrate_from_pictures({"a": [blank], "b": [blank, blank], "c": [blank]})


def test_known_distance_sets_the_scale(truth: dict[str, Camera]) -> None:
    """Catches a scale that is applied to the camera centres but not to the translations, and a squared scale."""
    cameras = scale_cameras(truth, Distance("b", "e", 10.0))
    assert np.linalg.norm(cameras["b"].centre - cameras["e"].centre) == pytest.approx(10)
    ratio = 10 / np.linalg.norm(truth["b"].centre - truth["e"].centre)
    np.testing.assert_allclose(cameras["c"].centre, ratio * truth["c"].centre)
    for pair, distance, words in ((("b", "x"), 1.0, "got 'x'"), (("b", "b"), 1.0, "two cameras at different")):
        with pytest.raises(UserError, match=words):
            scale_cameras(truth, Distance(*pair, distance))
    with pytest.raises(UserError, match="got -1"):
        scale_cameras(truth, Distance("b", "c", -1.0))


def _render_board(camera: Camera, columns: int, rows: int, square: float) -> Picture:
    """Image of a chessboard in the plane z = 0 on a white background. The inner corners start at the origin and extend
    along positive x and y. The square at the origin is black."""
    oversampling = 3
    u, v = ((np.arange(size * oversampling) + 0.5) / oversampling for size in (camera.width, camera.height))
    points = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    k = camera.intrinsics
    if camera.distortion is not None:
        points = cv2.undistortPoints(points, k, camera.distortion, R=None, P=k)
    rays = np.column_stack([points[:, 0], np.ones(len(points))]) @ np.linalg.inv(k).T @ camera.rotation
    distance = -camera.centre[2] / rays[:, 2]
    hit = camera.centre + rays * distance[:, None]
    x, y = np.floor(hit[:, 0] / square), np.floor(hit[:, 1] / square)
    inside = (x >= -1) & (x < columns) & (y >= -1) & (y < rows) & (distance > 0)
    grey = np.where(inside & ((x + y) % 2 == 0), 20, 235).astype(np.uint8)
    whole = grey.reshape(camera.height * oversampling, camera.width * oversampling)
    small = cv2.resize(whole, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.repeat(np.asarray(small, np.uint8)[..., None], 3, axis=2)


def _camera_above_board(angle: float, square: float) -> Camera:
    """A camera with distortion that looks down at the board's centre."""
    middle = np.array([3.5 * square, 2 * square, 0])
    centre = middle + 12 * square * np.array([0.6 * np.cos(angle), 0.6 * np.sin(angle), 0.8])
    intrinsics = np.array([[620.0, 0, 322], [0, 620, 236], [0, 0, 1]])
    camera = look_at(centre, middle, np.array([0.0, 0.0, 1.0]), intrinsics, 640, 480)
    return replace(camera, distortion=np.array([-0.05, 0.02, 0, 0]))


@pytest.mark.parametrize("angle", [0.3, 1.9, 3.6, 5.2])
def test_board_gives_the_pose_from_any_side(angle: float) -> None:
    """Catches a z axis that points into the board, half-pixel offsets, ignored distortion, and an origin that depends
    on the viewpoint."""
    square = 0.03
    camera = _camera_above_board(angle, square)
    unposed = Camera(camera.intrinsics, np.eye(3), np.zeros(3), 640, 480, camera.distortion)
    pose = board_pose(_render_board(camera, 8, 5, square), unposed, Board(8, 5, square))
    assert pose.centre[2] == pytest.approx(camera.centre[2], abs=0.001)
    assert np.linalg.norm(pose.centre - camera.centre) < 0.001
    assert _angle(pose.rotation, camera.rotation) < 0.2


def test_picture_without_a_board_is_refused() -> None:
    """Catches a pose from an image without a board, and invalid numbers of corners."""
    camera = _camera_above_board(0.3, 0.03)
    with pytest.raises(UserError, match="expected a chessboard of 8 x 5 inner corners, got none"):
        board_pose(np.full((480, 640, 3), 200, np.uint8), camera, Board(8, 5, 0.03))
    with pytest.raises(UserError, match="at least 3 x 3 inner corners"):
        board_pose(np.full((480, 640, 3), 200, np.uint8), camera, Board(8, 2, 0.03))


def test_cameras_align_to_known_poses(truth: dict[str, Camera], rng: np.random.Generator) -> None:
    """Catches an inverted similarity transform. Also catches a changed scale, because one known pose does not determine
    the scale."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    shift, scale = rng.normal(size=3), 2.5
    moved = {}
    for name, camera in truth.items():
        rotation = camera.rotation @ turn.T
        centre = scale * turn @ camera.centre + shift
        moved[name] = replace(camera, rotation=rotation, translation=-rotation @ centre)
    back = align_cameras(moved, {name: truth[name] for name in ("b", "d")})
    for name, camera in truth.items():
        np.testing.assert_allclose(back[name].centre, camera.centre, atol=1e-9)
        np.testing.assert_allclose(back[name].rotation, camera.rotation, atol=1e-9)
    one = align_cameras(moved, {"c": truth["c"]})
    np.testing.assert_allclose(one["c"].centre, truth["c"].centre, atol=1e-9)
    assert np.linalg.norm(one["a/1"].centre - one["c"].centre) == pytest.approx(
        scale * np.linalg.norm(truth["a/1"].centre - truth["c"].centre)
    )
    with pytest.raises(UserError, match="a calibrated camera that shows the board, got none"):
        align_cameras(moved, {"x": truth["c"]})
