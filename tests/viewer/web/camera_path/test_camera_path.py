"""Camera paths that the user makes on the page: adding views, playing, and the file for `fourd render --path`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fourd.viewer.camera_paths.keys import KeyedPath, KeyFrame
from fourd.viewer.camera_paths.reading import read_own_path
from fourd.viewer.navigation.saved_views import pose_to_json
from tests.viewer.camera_paths.test_motion import facing
from tests.viewer.web.page import PlayerPage


def test_a_path_is_added_played_and_saved(play: PlayerPage, tmp_path: Path) -> None:
    """Catches a key without effect, a path that does not end at its last view, and a file that cannot be rendered."""
    assert play.run("return [player.panel.playPath.hidden, player.panel.savePath.hidden];") == [True, True]
    poses = []
    for camera, frame in ((0, 1), (2, 4), (1, 4)):
        play.run(f"player.moveToCamera({camera}); player.seek({frame});")
        play.page.keyboard.press("k")
        poses.append(play.run("return stage.pose;"))
    assert play.run("return player.panel.playPath.hidden;") is False
    play.page.keyboard.press("y")
    play.wait("player.cameraPath.isPlaying && player.cameraPath.seconds > 0.2")
    assert play.run("return stage.pose;") not in poses
    play.run("player.cameraPath.seconds = 3.9;")
    play.wait("!player.cameraPath.isPlaying")
    assert play.run("return [stage.pose, stage.clock.frame];") == [poses[2], 4]
    with play.page.expect_download() as caught:
        play.run("player.panel.savePath.click();")
    name = caught.value.suggested_filename
    assert name.endswith(".path.json")
    caught.value.save_as(tmp_path / name)
    stored = read_own_path(tmp_path / name)
    assert isinstance(stored, KeyedPath)
    assert [(key.seconds, key.frame) for key in stored.keys] == [(0.0, 1.0), (2.0, 4.0), (4.0, 4.0)]
    for key, pose in zip(stored.keys, poses, strict=True):
        np.testing.assert_allclose(key.pose.rotation.ravel(), pose["rotation"], atol=1e-12)
        np.testing.assert_allclose(key.pose.pivot, pose["pivot"], atol=1e-12)


def test_the_users_own_view_ends_the_playing(play: PlayerPage) -> None:
    """Catches a path that takes the view out of the hand that drags it."""
    play.run("player.cameraPath.add(); player.moveToCamera(2); player.cameraPath.add(); player.cameraPath.toggle();")
    play.wait("player.cameraPath.seconds > 0.1")
    play.run("player.moveToCamera(1); window.chosen = stage.pose;")
    play.wait("!player.cameraPath.isPlaying")
    assert play.run("return stage.pose === window.chosen;") is True


def test_the_page_plays_the_path_that_is_rendered(play: PlayerPage) -> None:
    """Catches a preview that leads elsewhere than the rendered path: splines of another kind, or another speed."""
    angles, heights, zooms = np.radians([0, 40, 70, 120, 90]), (1.0, 1.5, 0.5, 1.0, 2.0), (0.8, 0.5, 0.9, 0.9, 0.6)
    places = zip(3 * np.cos(angles), 3 * np.sin(angles), heights, zooms, strict=True)
    poses = [facing(*(float(value) for value in place)) for place in places]
    frames, seconds = (0.0, 1.0, 1.0, 5.0, 4.0), (0.0, 1.0, 3.0, 3.5, 6.0)
    keys = [KeyFrame(*values) for values in zip(poses, seconds, frames, strict=True)]
    keys.append(KeyFrame(poses[-1], 7.0, 4.0))
    times = np.linspace(0, 7, 71)
    expected = KeyedPath(tuple(keys)).at(times)
    stored = [
        {
            **pose_to_json(key.pose),
            "rotation": key.pose.rotation.ravel().tolist(),
            "fieldOfView": key.pose.field_of_view,
            "seconds": key.seconds,
            "frame": key.frame,
        }
        for key in keys
    ]
    found = play.run(
        """
        const path = new player.cameraPath.path.constructor();
        path.keys = argument.keys.map(({seconds, frame, ...pose}) => ({seconds, frame, pose}));
        return argument.times.map((time) => path.at(time));
        """,
        {"keys": stored, "times": times.tolist()},
    )
    for sample, shown in zip(expected, found, strict=True):
        assert shown["frame"] == sample.frame
        rotation = np.reshape(shown["pose"]["rotation"], (3, 3))
        eye = np.subtract(shown["pose"]["pivot"], shown["pose"]["distance"] * rotation[2])
        np.testing.assert_allclose(eye, sample.pose.eye, atol=1e-6)
        assert abs(shown["pose"]["fieldOfView"] - sample.pose.field_of_view) < 1e-9
        turn = np.arccos(np.clip((np.trace(rotation @ sample.pose.rotation.T) - 1) / 2, -1, 1))
        assert np.degrees(turn) < 1e-4
