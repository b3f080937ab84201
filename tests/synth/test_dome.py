"""The synthetic dome: bodies of cameras, people who are cut off, colours and noise of each camera, and the truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.cli.main import main
from fourd.recording.capture import open_capture
from fourd.recording.synth.dome import DomeSettings, make_dome, suggested_test_views
from fourd.recording.synth.dome.generate import record_colours
from fourd.recording.synth.dome.people import lap_angle, lowest_height, make_cast, pose_cast
from fourd.recording.synth.dome.rig import make_rig, visible_fixtures
from fourd.recording.synth.dome.room import CEILING, CENTRE, RADIUS, make_room, render_room
from fourd.recording.synth.render import composite_parts

Array = NDArray[np.float64]
SMALL = DomeSettings(frames=2, cameras=6, size=80)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small dome that all tests of this module read."""
    path = tmp_path_factory.mktemp("dome") / "capture"
    make_dome(path, SMALL)
    return path


def _contents(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


def _read(path: Path) -> Array:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image.astype(np.float64)


def _rows(folder: Path) -> dict[str, dict[str, list[float]]]:
    return dict(json.loads((folder / "truth" / "rig.json").read_text())["cameras"])


def test_bytes_depend_on_the_settings_alone(folder: Path, tmp_path: Path) -> None:
    """Catches noise that depends on the order of the threads, and images that do not depend on the seed."""
    make_dome(tmp_path / "same", SMALL)
    make_dome(tmp_path / "other", replace(SMALL, seed=1))
    first, same, other = _contents(folder), _contents(tmp_path / "same"), _contents(tmp_path / "other")
    assert first == same
    assert first.keys() == other.keys()
    assert all(first[name] != other[name] for name in first if name.startswith(("images", "masks", "truth")))


def test_a_camera_sees_all_bodies_except_its_own() -> None:
    """Catches a camera that looks at the inside of its own body, and bodies that other cameras do not see."""
    rng = np.random.default_rng(3)
    room = make_room(rng)
    rig = make_rig(room, 10, 160, 90, rng)
    seen_by = np.zeros(len(rig), int)
    for index, item in enumerate(rig):
        empty = render_room(room, item.camera)
        parts = visible_fixtures(rig, index)
        rgb, coverage, depth = composite_parts(parts, item.camera, empty.rgb, 0.0)
        assert 0 < coverage.mean() < 0.05
        assert (depth[depth > 0] > 0.5).all()
        assert rgb[coverage > 0.6].mean() < 0.7 * empty.rgb[coverage > 0.6].mean()
        assert not {id(part) for part in item.body} & {id(part) for part in parts}
        distance = np.linalg.norm(item.body[0].origin - item.camera.centre)
        assert distance < 0.1, "the body is around the centre"
        for other, target in enumerate(rig):
            if other != index:
                seen_by[other] += composite_parts(target.body, item.camera, empty.rgb, 0.0)[1].any()
    assert (seen_by > 0).all()


def test_cameras_are_inside_the_walls(folder: Path) -> None:
    """Catches a camera outside the room, far from the wall, or closer to its wall than its near plane allows."""
    room = make_room(np.random.default_rng([SMALL.seed, 12]))
    for camera in open_capture(folder).cameras:
        offset = camera.centre - CENTRE
        gap = RADIUS - (room.normals @ offset).max()
        assert 0.01 < gap < 0.04
        assert 0.3 < camera.centre[2] < CEILING
        assert -camera.forward @ offset > 0.8 * np.linalg.norm(offset)
    for name in open_capture(folder).names:
        assert _read(folder / "truth" / "bg_depth" / f"{name}.png").min() > 500


def test_the_bodies_of_the_truth_surround_the_cameras(folder: Path) -> None:
    """Catches a rig.json whose bodies belong to other cameras."""
    capture = open_capture(folder)
    for camera, (name, row) in zip(capture.cameras, _rows(folder).items(), strict=True):
        assert name in capture.names
        body = row["body"]
        assert isinstance(body, dict)
        depths = [camera.forward @ (np.array(body[end]) - camera.centre) for end in ("back", "front")]
        assert depths[0] < -0.05
        assert 0 < depths[1] < 0.05


def test_people_are_whole_in_some_views_and_cut_off_in_others(tmp_path: Path) -> None:
    """Catches cameras that see only whole people, or no whole person."""
    make_dome(tmp_path / "out", DomeSettings(frames=3, cameras=16, size=64))
    capture = open_capture(tmp_path / "out")
    cut = []
    for camera in range(len(capture.names)):
        for frame in range(capture.frame_count):
            mask = capture.mask(camera, frame)
            cut.append(max(mask[[0, -1]].max(), mask[:, [0, -1]].max()) > 128)
    assert 0.2 < np.mean(cut) < 0.98


def test_masks_agree_between_the_views(folder: Path) -> None:
    """Catches masks of different moments: each surface point of a mask must be inside the masks of all other views
    that it projects into."""
    capture = open_capture(folder)
    for frame in range(capture.frame_count):
        for source, name in enumerate(capture.names):
            depth = _read(folder / "truth" / "depth" / name / f"{frame:06d}.png") / 1000
            i, j = np.nonzero(depth)
            xyz = capture.cameras[source].unproject(np.column_stack([j + 0.5, i + 0.5]), depth[i, j])
            assert (xyz[:, 2] > -0.005).all()
            for target, camera in enumerate(capture.cameras):
                pixels, z = camera.project(xyz)
                inside = camera.is_in_image(pixels, z)
                mask = cv2.dilate(capture.mask(target, frame), np.ones((3, 3), np.uint8))
                column, row = np.minimum(np.floor(pixels[inside]).astype(int), (camera.width - 1, camera.height - 1)).T
                assert (mask[row, column] > 0).all()


def test_people_are_in_front_of_everything_else(folder: Path) -> None:
    """Catches a person who walks through a wall, or behind a camera's body."""
    for name in open_capture(folder).names:
        empty = _read(folder / "truth" / "bg_depth" / f"{name}.png")
        for path in (folder / "truth" / "depth" / name).iterdir():
            depth = _read(path)
            assert (depth <= empty).all()


def test_feet_touch_the_floor_and_one_person_stands_still() -> None:
    """Catches people who float or sink into the floor, a standing person who walks, and a ball that stays."""
    cast = make_cast(2)
    moments = [pose_cast(cast, lap_angle(frame, 24)) for frame in range(24)]
    for moment in moments:
        for person in (moment.standing, moment.walking):
            assert abs(lowest_height([part for part in person if any(part is foot for foot in moment.feet)])) < 1e-9
    standing, walking = (
        np.array([[p.origin for p in getattr(m, who)] for m in moments]) for who in ("standing", "walking")
    )
    assert np.ptp(standing, axis=0).max() < 0.06
    assert np.ptp(walking, axis=0).max(axis=1).min() > 0.8
    balls = np.array([moment.ball.origin for moment in moments])
    assert np.ptp(balls[:, 0]) > 1.2
    assert np.linalg.norm(np.diff(balls, axis=0), axis=1).max() < 0.6
    assert balls[:, 2].min() > 0.5


def test_gains_are_stored_and_differ(folder: Path) -> None:
    """Catches gains that are the same for all cameras, or differ from those in the images."""
    gains = np.array([row["gain"] for row in _rows(folder).values()])
    assert gains.shape == (SMALL.cameras, 3)
    assert np.allclose(np.exp(np.log(gains).mean(axis=0)), 1)
    assert (gains.std(axis=0) > 0.02).all()
    assert np.abs(np.log(gains)).max() < 0.5
    room = make_room(np.random.default_rng([SMALL.seed, 12]))
    for camera, (name, row) in zip(open_capture(folder).cameras, _rows(folder).items(), strict=True):
        light = render_room(room, camera).rgb
        plate = _read(folder / "truth" / "bgs" / f"{name}.png")[..., ::-1]
        usual = (light > 0.1).all(axis=2) & (light < 0.6).all(axis=2)
        ratio = np.median(plate[usual] / 255 / light[usual], axis=0)
        assert np.allclose(ratio, row["gain"], rtol=0.02)


def test_noise_changes_from_frame_to_frame(folder: Path) -> None:
    """Catches images without noise, and noise that is the same in all frames."""
    capture = open_capture(folder)
    plate = _read(folder / "truth" / "bgs" / "00.png")[..., ::-1]
    masks = cv2.dilate(np.maximum(capture.mask(0, 0), capture.mask(0, 1)), np.ones((13, 13), np.uint8))
    quiet = (masks == 0) & (plate.max(axis=2) < 200)
    assert quiet.sum() > 100
    first, second = (capture.image(0, frame).astype(float)[quiet] for frame in (0, 1))
    assert 1.0 < (first - second).std() < 6.0
    light = np.full((40, 40, 3), 0.5)
    recorded = record_colours(light, np.array([1.2, 1.0, 0.8]), np.random.default_rng(0)).astype(float)
    assert np.allclose(recorded.mean(axis=(0, 1)) / 255, [0.6, 0.5, 0.4], atol=0.003)
    assert 1.5 < recorded[..., 1].std() < 4


def test_lamps_are_saturated_in_every_colour(folder: Path) -> None:
    """Catches lamps that a camera of a low gain records as grey."""
    saturated = [(_read(file).min(axis=2) == 255).mean() for file in (folder / "truth" / "bgs").iterdir()]
    assert np.mean([share > 0 for share in saturated]) > 0.6
    assert max(saturated) < 0.1


def test_suggested_views_have_neighbours_on_all_sides() -> None:
    """Catches suggestions at the edge of the rig, and suggested cameras that are neighbours."""
    settings = DomeSettings(frames=1, cameras=31, size=64)
    names = suggested_test_views(settings)
    assert 2 <= len(names) <= 4
    assert all(3 <= int(name) <= 27 for name in names)


def test_the_command_makes_a_dome_with_and_without_masks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a command that cannot be repeated, masks that --no-masks leaves in the capture, and a missing reason."""
    words = ["synth", str(tmp_path / "out"), "--dome", "--frames", "1", "--cameras", "5", "--size", "64"]
    assert main(words) == 0
    text = capsys.readouterr().err
    assert "5 cameras x 1 frames" in text
    assert "--test-views 0" in text
    assert open_capture(tmp_path / "out").has_masks
    assert main(words) == 0
    assert "already finished with these settings" in capsys.readouterr().err
    assert main([*words, "--no-masks"]) == 0
    assert "made again (masks: True -> False)" in capsys.readouterr().err
    capture = open_capture(tmp_path / "out")
    assert not capture.has_masks
    assert capture.image(0, 0).shape == (36, 64, 3)
    assert (tmp_path / "out" / "truth" / "masks" / "04" / "000000.png").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--dome", "--board"), "--dome: expected one of --board and --dome"),
        (("--no-masks",), "--no-masks: expected the option --dome"),
        (("--dome", "--size", "63"), "--size: expected 64 to 4096 with --dome, got 63"),
        (("--dome", "--cameras", "2"), "--cameras: expected 3 to 100 with --dome, got 2"),
        (("--dome", "--gloss", "nan"), "--gloss: expected 0 to 1 with --dome"),
    ],
)
def test_unusable_options_are_refused(
    words: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches options that are ignored without a word, and files that are written before the refusal."""
    assert main(["synth", str(tmp_path / "out"), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
