"""Synthetic board videos: their ground truth, equal bytes for equal settings, and folders with other files."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.cli.main import main
from fourd.recording.boards import read_board
from fourd.recording.capture.calibration import read_calibration
from fourd.recording.capture.video import VideoReader, index_video
from fourd.recording.synth.board_render import BoardPose, BoardRenderer, Optics
from fourd.recording.synth.board_videos import BOARD, BoardSettings, board_pose, rig_cameras


def test_the_command_writes_videos_and_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a video without ground truth, and results that differ between two calls with equal options."""
    contents = []
    for name in ("a", "b"):
        words = ["synth", tmp_path / name, "--board", "--frames", 3, "--cameras", 2, "--size", 128, "--seed", 4]
        assert main([str(word) for word in words]) == 0
        files = sorted(path for path in (tmp_path / name).rglob("*") if path.is_file())
        contents.append({str(path.relative_to(tmp_path / name)): path.read_bytes() for path in files})
    assert contents[0] == contents[1]
    assert "2 videos of 3 frames" in capsys.readouterr().err
    assert read_board(tmp_path / "a" / "board.toml") == BOARD
    settings = BoardSettings(frames=3, cameras=2, size=128, seed=4)
    truth = read_calibration(tmp_path / "a" / "truth")
    for camera, found in zip(rig_cameras(settings), truth.values(), strict=True):
        assert np.allclose(camera.rotation, found.rotation, atol=1e-9)
    poses = json.loads((tmp_path / "a" / "truth" / "board_poses.json").read_text())
    assert np.allclose(poses[2]["translation"], board_pose(settings, 2.0).translation)
    path = tmp_path / "a" / "videos" / "cam01.mp4"
    with VideoReader(path, index_video(path)) as reader:
        assert reader.index.frames == 3
        assert reader.read(1).shape == (128, 128, 3)


def test_other_folders_are_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a folder with the user's files that is overwritten, and numbers that are out of range."""
    (tmp_path / "notes.txt").write_text("mine")
    assert main(["synth", str(tmp_path), "--board"]) == 2
    assert "got other files; name another folder" in capsys.readouterr().err
    assert main(["synth", str(tmp_path / "new"), "--board", "--cameras", "1"]) == 2
    assert "--cameras: expected 2 to 100 with --board, got 1" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_the_image_is_where_the_projection_is() -> None:
    """Catches a rendered board that is shifted, mirrored or not distorted. The test compares its bounding box with that
    of the projected outline.
    """
    settings = BoardSettings(size=256)
    camera = rig_cameras(settings)[0]
    tilt = board_pose(settings, 4.0).rotation
    pose = BoardPose(tilt, tilt @ (-0.2, -0.15, 0.0))
    picture = BoardRenderer(BOARD, camera, Optics(0.3, 0.01)).render([pose], np.random.default_rng(0)).astype(float)
    rows, columns = np.nonzero(np.abs(picture - 110) > 50)
    border = 0.5 * BOARD.square_m
    x, y = (np.array([-border, side + border]) for side in BOARD.size_m)
    flat = np.array([(x[i], y[j], 0.0) for i in (0, 1) for j in (0, 1)])
    in_camera = (flat @ tilt.T + pose.translation) @ camera.rotation.T + camera.translation
    assert camera.distortion is not None
    pixels, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), camera.intrinsics, camera.distortion)
    pixels = pixels.reshape(-1, 2)
    assert np.abs(pixels.min(axis=0) - (columns.min(), rows.min())).max() < 1.2
    assert np.abs(pixels.max(axis=0) - (columns.max() + 1, rows.max() + 1)).max() < 1.2


def test_a_moving_board_is_blurred() -> None:
    """Catches a rendering that shows only one moment of the exposure."""
    settings = BoardSettings(size=128)
    renderer = BoardRenderer(BOARD, rig_cameras(settings)[1], Optics(0.6, 0.01))
    still, moved = board_pose(settings, 4.0), board_pose(settings, 5.0)
    pictures = [renderer.render(poses, np.random.default_rng(0)) for poses in ([still], [moved], [still, moved])]
    mean = (pictures[0].astype(float) + pictures[1]) / 2
    assert np.abs(pictures[2] - mean).max() < 2
