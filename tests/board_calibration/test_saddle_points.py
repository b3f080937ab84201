"""Sub-pixel positions of corners in rendered images with blur, noise and lens distortion."""

from __future__ import annotations

import numpy as np

from fourd.recording.board_calibration.adjustment.rig import Poses, RigState, project
from fourd.recording.board_calibration.detection import BoardDetector
from fourd.recording.board_calibration.saddle_points import refine_corners
from fourd.recording.boards import draw_board
from fourd.recording.synth.board_render import BoardRenderer
from fourd.recording.synth.board_videos import BoardSettings, board_pose, rig_cameras
from tests.board_calibration.rigs import flat_corners


def test_corners_are_precise_in_blurred_images() -> None:
    """Catches corners that are shifted by up to 3 px because of nearby markers, and a bias of half a pixel."""
    settings = BoardSettings(size=500)
    camera = rig_cameras(settings)[1]
    renderer, detector = BoardRenderer(settings.board, camera, settings.optics), BoardDetector(settings.board)
    errors = []
    for frame in range(0, 60, 6):
        pose = board_pose(settings, float(frame))
        view = detector.detect(renderer.render([pose], np.random.default_rng(frame)), 0, frame)
        if view is None:
            continue
        state = RigState((camera,), Poses(pose.rotation[None], pose.translation[None]))
        corners = flat_corners(settings.board.corners[view.corners], view.pixels)
        errors.append(view.pixels - project(state, corners).pixels)
    found = np.concatenate(errors)
    distances = np.linalg.norm(found, axis=1)
    assert len(found) > 100
    assert np.median(distances) < 0.05
    assert np.percentile(distances, 99) < 0.25
    assert np.abs(np.median(found, axis=0)).max() < 0.015


def test_places_without_a_corner_are_refused() -> None:
    """Catches a search that returns the middle of a square as a corner."""
    settings = BoardSettings()
    picture = draw_board(settings.board, 40, margin=20)
    flat = settings.board.corners[:, :2] / settings.board.square_m
    pixels = flat * (40, -40) + (20, picture.shape[0] - 20) - 0.5
    found, is_saddle = refine_corners(picture, flat, pixels + 0.8, 0.12)
    assert is_saddle.all()
    assert np.abs(found - pixels).max() < 0.05
    _, is_saddle = refine_corners(picture, flat, pixels + np.array([8, 3]), 0.12)
    assert not is_saddle.any()
