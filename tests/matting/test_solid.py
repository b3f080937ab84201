"""Subjects that stand still: the room, the points inside it that are connected with motion, and their silhouettes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.progress import untracked
from fourd.recording.capture import open_capture
from fourd.recording.matting.motion.sampling import CameraSample
from fourd.recording.matting.motion.subject import learn_subject
from fourd.recording.matting.solid.moments import MIN_CAMERAS, Moments, reconstruct_moments
from fourd.recording.matting.solid.resting import RestingParts
from fourd.recording.matting.solid.room import Room
from fourd.recording.matting.solid.silhouette import point_silhouette
from fourd.recording.matting.solid.subject import SolidSubject
from fourd.recording.matting.solid.subject_points import find_subject_points
from tests.captures import write_ball_capture

Array = NDArray[np.float64]
RADIUS = 3.0
SIZE = 96


def wall_cameras(count: int = 12, height: float = 0.4) -> list[Camera]:
    """Cameras on a circle that face the origin."""
    cameras = []
    for angle in np.arange(count) * 2 * np.pi / count:
        centre = RADIUS * np.array([np.cos(angle), np.sin(angle), height / RADIUS])
        forward = -centre / np.linalg.norm(centre)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        k = np.array([[60.0, 0, SIZE / 2], [0, 60.0, SIZE / 2], [0, 0, 1]])
        cameras.append(Camera(k, rotation, -rotation @ centre, SIZE, SIZE))
    return cameras


def sphere(rng: np.random.Generator, count: int = 20_000) -> Array:
    """Points on the walls of a round room."""
    directions = rng.normal(size=(count, 3))
    return RADIUS * 1.1 * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def column(rng: np.random.Generator, x: float, low: float, high: float, count: int = 1500) -> Array:
    """Points of an upright body at (x, 0)."""
    angle, z = rng.uniform(0, 2 * np.pi, count), rng.uniform(low, high, count)
    return np.stack([x + 0.2 * np.cos(angle), 0.2 * np.sin(angle), z], axis=1)


def regions_of(xyz: Array, cameras: list[Camera]) -> list[NDArray[np.bool_]]:
    return [point_silhouette(xyz, 0.2, camera) for camera in cameras]


def test_whoever_stands_before_the_wall_is_not_the_wall(rng: np.random.Generator) -> None:
    """Catches a room that shrinks to people who hide the wall behind them, so that they count as wall."""
    cameras = wall_cameras()
    body, wall = column(rng, 1.5, -0.8, 0.8), sphere(rng)
    hidden = np.linalg.norm(wall - [3.3, 0, 0], axis=1) < 0.25
    room = Room.around(np.zeros(3), np.concatenate([wall[~hidden], body]), cameras)
    assert np.median(room.depth_share(body)) < 0.7
    assert np.quantile(np.abs(room.depth_share(wall) - 1), 0.95) < 0.05


def test_a_standing_body_belongs_to_its_moving_head(rng: np.random.Generator) -> None:
    """Catches legs that are lost because they do not move, and furniture that becomes the subject."""
    cameras = wall_cameras()
    body, table = column(rng, 0.8, -0.8, 0.8), column(rng, -1.2, -0.8, -0.2)
    head = body[body[:, 2] > 0.55]
    cloud = np.concatenate([sphere(rng), body, table])
    (found,) = find_subject_points([cloud], cameras, regions_of(head, cameras)).moments
    assert abs(len(found) - len(body)) < 0.05 * len(body)
    assert found[:, 0].min() > 0.3


def test_the_floor_under_a_subject_is_not_the_subject(rng: np.random.Generator) -> None:
    """Catches a floor that counts as part of an animal on it. The hull of fox_run without three of its cameras was then
    carved by the few cameras that see most of the floor, and the mattes lacked the animal's middle."""
    cameras = wall_cameras(16, height=0.8)
    place = 5 * rng.uniform(-1, 1, (60_000, 2))
    floor = np.column_stack([place, rng.normal(-0.05, 0.005, len(place))])
    animal = rng.uniform([-0.2, -0.7, -0.05], [0.2, 0.7, 0.5], (4000, 3))
    regions = regions_of(animal, cameras)
    (found,) = find_subject_points([np.concatenate([floor, animal])], cameras, regions).moments
    assert len(found) > 0.3 * len(animal)
    assert np.mean(np.abs(found[:, 1]) > 0.8) < 0.01
    solid = SolidSubject((0,), (found,), (), 0.1)
    assert solid.seeing_share(cameras) > 0.7


def test_who_moves_once_belongs_to_the_subject_at_all_times(rng: np.random.Generator) -> None:
    """Catches a person who stands still and is a part of the background, because only a hand moved, at one of the
    moments. In a generated dome, the mattes of such a person were empty. A chair does not
    belong to the subject, and a person who walks does not rest."""
    cameras = wall_cameras()
    body, chair = column(rng, 0.8, -0.8, 0.8), column(rng, -1.5, -0.8, -0.2)
    hand = body[:, 2] > 0.75
    raised = column(rng, 0.8, 0.75, 0.95, int(hand.sum()))
    walker = [column(rng, x, -0.8, 0.8) for x in (-0.5, 0.0, -0.5)]
    room = sphere(rng)
    moments = [
        np.concatenate([room, body, chair, walker[0]]),
        np.concatenate([room, body[~hand], raised, walker[1]]),
        np.concatenate([room, body, walker[2]]),
    ]
    regions = regions_of(np.concatenate([body[hand], raised, *walker]), cameras)
    found = find_subject_points(moments, cameras, regions)
    for xyz in found.moments:
        assert np.sum(xyz[:, 0] > 0.5) > 0.9 * len(body)
        assert np.sum(xyz[:, 0] < -1.2) == 0
    for xyz in found.resting:
        assert np.sum(xyz[:, 0] > 0.5) > 0.8 * len(body)
        assert np.sum(xyz[:, 0] < 0.4) == 0


def test_silhouettes_between_moments_are_those_of_who_rests(rng: np.random.Generator) -> None:
    """Catches frames between two moments in which a person who stands still is learned as background, and frames in
    which a person is expected where she was before."""
    cameras = wall_cameras()
    body, walker = column(rng, 0.8, -0.8, 0.8), [column(rng, x, -0.8, 0.8) for x in (-0.6, 0.0)]
    points = tuple(np.concatenate([body, each]) for each in walker)
    masks = SolidSubject((1, 4), points, (body,), 0.1).silhouettes(cameras[3], 6)
    alone = point_silhouette(body, 0.1, cameras[3])
    assert not masks[[0, 5]].any()
    assert all((masks[frame] == alone).all() for frame in (2, 3))
    assert all(masks[frame].sum() > alone.sum() for frame in (1, 4))


def test_resting_parts_are_subject_in_every_frame_between_moments(rng: np.random.Generator, tmp_path: Path) -> None:
    """Catches a torso that is missing in the frames between two moments, because its colour is that of the wall, and
    resting parts that are lost when the learned models are read again."""
    cameras = wall_cameras()
    body = column(rng, 0.8, -0.8, 0.8)
    solid = SolidSubject((0, 2, 3), (body, body, body), (body, np.zeros((0, 3))), 0.1)
    resting = RestingParts.of(solid, [10, 15, 20, 29])
    assert resting is not None
    np.savez(tmp_path / "a.npz", **resting.arrays())
    with np.load(tmp_path / "a.npz") as arrays:
        again = RestingParts.from_arrays(arrays)
    assert again is not None
    silhouette = point_silhouette(body, 0.1, cameras[2])
    for parts in (resting, again):
        assert parts.frames == (10, 20, 29)
        for frame in (10, 13, 20):
            odds = parts.log_odds(frame, cameras)
            assert odds is not None
            assert np.mean((odds[2] > 0) == silhouette) > 0.999
        assert parts.log_odds(9, cameras) is None
        assert parts.log_odds(25, cameras) is None
    assert RestingParts.of(SolidSubject((0, 1), (body, body), (np.zeros((0, 3)),), 0.1), [0, 5]) is None
    assert RestingParts.from_arrays({}) is None


@pytest.mark.parametrize(
    "damage", [{"resting_counts": [3, 4]}, {"resting_points": [[np.nan] * 3]}, {"resting_spacing": 0}]
)
def test_damaged_resting_parts(damage: dict[str, Any]) -> None:
    """Catches points that are given to the wrong frames, and a model whose numbers are not finite."""
    arrays = {"resting_frames": [0, 4], "resting_counts": [1], "resting_points": [[0.0, 0, 1]], "resting_spacing": 0.1}
    assert RestingParts.from_arrays({name: np.array(each) for name, each in arrays.items()}) is not None
    with pytest.raises(ValueError, match="resting points of the wrong shape"):
        RestingParts.from_arrays({name: np.array(each) for name, each in (arrays | damage).items()})


def test_nothing_moves_nothing_is_found(rng: np.random.Generator) -> None:
    """Catches an empty list of points that ends the matting with a traceback, and subjects without any motion."""
    cameras = wall_cameras()
    still = [np.zeros((SIZE, SIZE), bool)] * len(cameras)
    cloud = np.concatenate([sphere(rng), column(rng, 0.8, -0.8, 0.8)])
    for points in (cloud, np.zeros((0, 3))):
        assert [len(xyz) for xyz in find_subject_points([points], cameras, still).moments] == [0]
        assert SolidSubject.from_moments(Moments((0,), (points,)), cameras, still) is None


def test_box_and_views_of_a_subject_that_images_cut_off(rng: np.random.Generator) -> None:
    """Catches legs outside the box of the moving head, and legs that are carved away by cameras that do not see
    them."""
    cameras = wall_cameras()
    body = column(rng, 1.9, -1.2, 0.8)
    solid = SolidSubject((1,), (body,), (), 0.1)
    lower, upper = solid.extend((np.full(3, 0.4), np.full(3, 0.7)))
    assert (lower < np.quantile(body, 0.02, axis=0)).all()
    assert (upper > np.quantile(body, 0.98, axis=0)).all()
    seen = np.mean([camera.is_in_image(*camera.project(body)) for camera in cameras], axis=0)
    assert np.mean(seen >= solid.seeing_share(cameras)) > 0.97
    assert solid.seeing_share(cameras) < 0.75
    everywhere = [np.ones((SIZE, SIZE), bool)] * len(cameras)
    assert solid.covered_share((lower, upper), cameras, everywhere) > 0.95
    assert 0.3 < solid.covered_share((lower, upper * [1, 1, 0]), cameras, everywhere) < 0.8
    masks = solid.silhouettes(cameras[0], 3)
    assert masks[1].any()
    assert not masks[[0, 2]].any()


def test_silhouettes_have_no_gaps(rng: np.random.Generator) -> None:
    """Catches silhouettes that are sprinkled with holes between the points, or grow beyond them."""
    camera = wall_cameras()[0]
    body = column(rng, 0.0, -0.6, 0.6, 600)
    mask = point_silhouette(body, 0.15, camera)
    rows, columns = np.nonzero(mask)
    box = (rows.max() - rows.min() + 1) * (columns.max() - columns.min() + 1)
    assert mask.sum() > 0.75 * box
    assert abs((columns.max() - columns.min() + 1) - 60 * 0.4 / 3) < 4
    assert not point_silhouette(body + 10 * camera.centre, 0.15, camera).any()


def sway(frame: int) -> Array:
    """Position (3,) of the moving head in a frame."""
    return np.array([0, 0.25 * np.sin(frame), 0])


def _scene(cameras: list[Camera], body: Array, head: Array, frames: int) -> list[CameraSample]:
    """Images of a grey wall before which a dark body stands still, with a light head that moves sideways."""
    samples = []
    for camera in cameras:
        rgb = np.full((frames, SIZE, SIZE, 3), 120, np.uint8)
        rgb += np.random.default_rng(0).integers(0, 4, rgb.shape, np.uint8)
        motion = np.zeros((frames, SIZE, SIZE), np.float16)
        for frame in range(frames):
            rgb[frame][point_silhouette(body, 0.15, camera)] = (60, 70, 80)
            moved = point_silhouette(head + sway(frame), 0.15, camera)
            rgb[frame][moved] = (220, 180, 160)
            motion[frame][moved] = 3
        samples.append(CameraSample(camera, rgb, motion))
    return samples


def test_a_body_that_never_moves_is_found_with_its_head(rng: np.random.Generator) -> None:
    """Catches mattes of heads without bodies: whoever stands still is wall to the median over time."""
    cameras = wall_cameras(10)
    body, head = column(rng, 0.5, -0.8, 0.5), column(rng, 0.5, 0.5, 0.9)
    samples = _scene(cameras, body, head, 6)
    moment = np.concatenate([sphere(rng), body, head + sway(2)])
    names = [str(index) for index in range(len(cameras))]
    shares = []
    for moments in (None, Moments((2,), (moment,))):
        subject = learn_subject(samples, names, 0, untracked, moments)
        parts = []
        for appearance, sample in zip(subject.appearances, samples, strict=True):
            legs = point_silhouette(body[body[:, 2] < 0], 0.15, sample.camera)
            parts.append((appearance.log_odds(sample.rgb[3], sample.motion_px[3].astype(np.float32)) > 0)[legs].mean())
        shares.append(np.mean(parts))
    assert shares[0] < 0.2
    assert shares[1] > 0.9


def test_few_cameras_are_left_alone(tmp_path: Path) -> None:
    """Catches stereo between cameras that are too far apart, which takes minutes and finds nothing."""
    capture = write_ball_capture(tmp_path / "capture", cameras=MIN_CAMERAS - 1, frames=2, size=32)
    with open_capture(capture) as opened:
        assert reconstruct_moments(opened, [0, 1], 0, 1, untracked) is None


def test_moments_of_short_recordings(tmp_path: Path) -> None:
    """Catches short recordings with fewer frames than moments, and images in which stereo finds nothing."""
    capture = write_ball_capture(tmp_path / "capture", cameras=MIN_CAMERAS, frames=1, size=32)
    with open_capture(capture) as opened:
        found = reconstruct_moments(opened, [0], 0, 1, untracked)
    assert found is not None
    assert found.frames == (0,)
    assert found.points[0].shape[1] == 3
