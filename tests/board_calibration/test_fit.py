"""The fit of a rig: derivatives, accuracy, cameras that are connected only through other cameras, outliers, and error
messages.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.progress import untracked
from fourd.recording.board_calibration.adjustment import solver
from fourd.recording.board_calibration.adjustment.rig import (
    PARAMETERS,
    BoardShape,
    Poses,
    RigState,
    Timing,
    collect_corners,
    project,
)
from fourd.recording.board_calibration.adjustment.system import Free
from fourd.recording.board_calibration.detection import BoardView
from fourd.recording.board_calibration.fit import choose_held_out, fit_rig
from fourd.recording.board_calibration.report import coverage, report_cameras, time_lines
from fourd.recording.boards import CalibrationBoard
from fourd.recording.synth.board_videos import BoardSettings, board_pose
from tests.board_calibration.rigs import Filming, largest_differences, rig_input, seen_views

SETTINGS = BoardSettings(frames=40, cameras=3)


def true_state(settings: BoardSettings, frames: range) -> RigState:
    cameras, _ = seen_views(settings, frames)
    poses = [board_pose(settings, float(frame)) for frame in frames]
    return RigState(
        tuple(cameras), Poses(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses]))
    )


def test_derivatives_are_those_of_the_projection() -> None:
    """Catches a wrong sign or order of a parameter. The solver would then need many steps or stop early."""
    frames, count = range(3), len(SETTINGS.board.corners)
    _, views = seen_views(SETTINGS, frames, filming=Filming(backs=(1,)))
    corners = collect_corners(SETTINGS.board, views, frames)
    generator = np.random.default_rng(0)
    timing = Timing(
        np.array([0.0, 0.3, -0.2]),
        np.array([0.5, 0.2, 0.8]),
        np.array([[0, 1 / 640], [1 / 640, 0], [0, 1 / 640]]),
        generator.normal(0, 0.03, (3, 6)),
    )
    shape = BoardShape(generator.normal(0, 1e-3, (count, 3)), 0.004)
    state = replace(true_state(SETTINGS, frames), timing=timing, shape=shape)
    free = Free(np.ones((3, PARAMETERS), bool), np.full((count, 3), 1e-4), thickness=True)
    found = project(state, corners)

    def slope(place: int | None, parameter: int = 0) -> np.ndarray:
        shared, boards = np.zeros(3 * PARAMETERS + 3 * count + 1), np.zeros((3, 6))
        if place is None:
            boards[:, parameter] = 1e-6
        else:
            shared[place::PARAMETERS][:3] = 1e-6
            if place >= PARAMETERS:
                shared[:] = 0
                shared[place] = 1e-6
        return (project(solver.move(state, free, shared, boards), corners).pixels - found.pixels) / 1e-6

    for parameter in range(PARAMETERS):
        assert np.abs(slope(parameter) - found.by_camera[..., parameter]).max() < 2e-2, parameter
    for parameter in range(6):
        assert np.abs(slope(None, parameter) - found.by_board[..., parameter]).max() < 2e-2, parameter
    for axis in range(3):
        expected = found.by_corner[..., axis] * (corners.ids == 5)[:, None]
        assert np.abs(slope(3 * PARAMETERS + 15 + axis) - expected).max() < 2e-2, axis
    assert np.abs(slope(3 * PARAMETERS + 3 * count) + found.by_corner[..., 2] * corners.back[:, None]).max() < 2e-2


def test_the_rig_is_recovered() -> None:
    """Catches a bias of lenses or poses, and a prior that outweighs precise corners."""
    cameras, views = seen_views(SETTINGS, range(40))
    fit = fit_rig(rig_input(SETTINGS, views), untracked)
    focal, degrees, position = largest_differences(fit.cameras, cameras)
    assert focal < 0.1
    assert degrees < 0.1
    assert position < 0.2
    for index in range(3):
        held_out = fit.rms(index, held_out=True)
        assert held_out is not None
        # The noise is 0.05 px along each axis.
        assert 0.05 < held_out < 0.1
        assert fit.std[index, 6] < 0.002 * cameras[index].intrinsics[0, 0]
    assert fit.held_out.sum() == 8


def test_known_lenses_are_kept() -> None:
    """Catches a known lens that is adjusted, and an unknown lens that is not adjusted."""
    cameras, views = seen_views(SETTINGS, range(20))
    fit = fit_rig(rig_input(SETTINGS, views, [cameras[0], None, cameras[2]]), untracked)
    for index in (0, 2):
        assert np.array_equal(fit.cameras[index].intrinsics, cameras[index].intrinsics)
    assert fit.estimated.tolist() == [False, True, False]
    assert not fit.std[0].any()
    assert largest_differences(fit.cameras, cameras)[1] < 0.1


def test_cameras_are_joined_through_others() -> None:
    """Catches a fit that needs one frame in which all cameras see the board. In this test, the first and the last
    camera see the board in no common frame."""
    cameras, views = seen_views(SETTINGS, range(40), {0: range(20), 2: range(20, 40)})
    fit = fit_rig(rig_input(SETTINGS, views), untracked)
    assert sorted((pair.first, pair.second) for pair in fit.pairs) == [(0, 1), (1, 2)]
    assert largest_differences(fit.cameras, cameras)[1] < 0.15


def test_separate_groups_of_cameras_are_named() -> None:
    """Catches a fit that accepts groups of cameras that never see the board together."""
    settings = replace(SETTINGS, cameras=4)
    _, views = seen_views(settings, range(40), {0: range(20), 1: range(20), 2: range(20, 40), 3: range(20, 40)})
    with pytest.raises(UserError, match=r"^videos: .* separate groups: a and b; c and d; film the board where"):
        fit_rig(rig_input(settings, views), untracked)


def test_wrong_corners_do_not_matter() -> None:
    """Catches camera poses that are distorted by a few corners with an error of 20 px."""
    cameras, views = seen_views(SETTINGS, range(40))
    generator = np.random.default_rng(1)
    for view in views[::4]:
        view.pixels[generator.integers(len(view.pixels))] += generator.choice([-20, 20], 2)
    fit = fit_rig(rig_input(SETTINGS, views), untracked)
    focal, degrees, _ = largest_differences(fit.cameras, cameras)
    assert focal < 0.15
    assert degrees < 0.1


def test_boards_of_different_sizes_are_refused() -> None:
    """Catches a fit that accepts a camera that sees a board with larger squares. No rigid rig explains such views."""
    _, views = seen_views(SETTINGS, range(40))
    larger = replace(SETTINGS, board=replace(SETTINGS.board, square_m=0.1, marker_m=0.075))
    _, others = seen_views(larger, range(40))
    mixed = [view for view in views if view.camera != 2] + [view for view in others if view.camera == 2]
    with pytest.raises(UserError, match=r"expected one rigid board of 80 mm squares .* squares of the same size"):
        fit_rig(rig_input(SETTINGS, mixed), untracked)


def test_too_few_views_are_refused() -> None:
    """Catches a lens that is estimated from two views, and a board that only one camera sees and that is accepted."""
    _, views = seen_views(SETTINGS, range(40), {1: range(2)})
    with pytest.raises(UserError, match=r"videos: b: expected the board in at least 5 frames, got [12];"):
        fit_rig(rig_input(SETTINGS, views), untracked)
    _, views = seen_views(SETTINGS, range(40), {1: (), 2: ()})
    with pytest.raises(UserError, match=r"expected two cameras that see the board, got only a"):
        fit_rig(rig_input(SETTINGS, views), untracked)


def test_rare_views_stay_in_the_fit() -> None:
    """Catches held-out frames of a camera, or of a pair of cameras, that has too few frames for the fit."""
    few = [BoardView(camera, frame, np.arange(8), np.zeros((8, 2))) for camera in (0, 1) for frame in range(8)]
    assert choose_held_out(few, range(8)) == set()
    many = [BoardView(camera, frame, np.arange(8), np.zeros((8, 2))) for camera in (0, 1) for frame in range(30)]
    assert choose_held_out(many, range(30)) == {2, 7, 12, 17, 22, 27}


def test_badly_determined_values_are_reported() -> None:
    """Catches a report that does not warn about a board that is always frontal and small in the image."""
    frontal = CalibrationBoard(7, 5, 0.02, 0.015, "DICT_4X4_50")
    settings = BoardSettings(frames=12, cameras=2, board=frontal)
    cameras, _ = seen_views(settings, range(1))
    views = []
    for frame in range(12):
        shift = np.array([0.02 * frame, 0, 1.5])
        for index, camera in enumerate(cameras):
            flat = frontal.corners[:, :2] * (1, -1) + shift[:2]
            pixels = flat / shift[2] * camera.intrinsics[0, 0] + camera.intrinsics[:2, 2]
            noise = np.random.default_rng([frame, index]).normal(0, 0.1, pixels.shape)
            views.append(BoardView(index, frame, np.arange(24), pixels + noise))
    fit = fit_rig(rig_input(settings, views), untracked)
    lines = "\n".join(line for camera in report_cameras(fit, ("a", "b")) for line in camera.warnings)
    for words in ("only 12 views", "of the image, so the distortion", "always frontal", "focal length is uncertain"):
        assert words in lines


def test_coverage_is_the_share_of_cells() -> None:
    """Catches a coverage that counts corners instead of cells, or cells outside the image."""
    pixels = np.array([[1.0, 1], [2, 2], [79, 59], [-5, 3], [80.5, 10]])
    assert coverage(pixels, 80, 60) == pytest.approx(2 / 48)


def test_late_cameras_and_slow_readouts_are_found() -> None:
    """Catches a fit that assumes simultaneous exposure although cameras are delayed and have rolling shutters."""
    filming = Filming(delays={1: 0.05, 2: -0.05}, readout=0.1)
    cameras, views = seen_views(SETTINGS, range(40), filming=filming)
    fit = fit_rig(rig_input(SETTINGS, views), untracked)
    assert fit.timing is not None
    assert np.abs(fit.timing.delay - (0, 0.05, -0.05)).max() < 0.005
    assert np.abs(fit.timing.readout - 0.1).max() < 0.005
    focal, degrees, position = largest_differences(fit.cameras, cameras)
    assert focal < 0.15
    assert degrees < 0.2
    assert position < 0.3
    lines = time_lines(fit, ("a", "b", "c"), 10.0)
    assert [line.split(";")[0] for line in lines] == ["a gives the time", "b lags a by 5 ms", "c lags a by -5 ms"]
    assert lines[0].endswith("its rows are read within 10 ms")


def test_turned_videos_are_read_along_their_width() -> None:
    """Catches a readout along the height of an image that was turned upright by 90 degrees."""
    filming = Filming(readout=0.1, across=True)
    _, views = seen_views(SETTINGS, range(40), filming=filming)
    fit = fit_rig(replace(rig_input(SETTINGS, views), turns=(90, 270, 90)), untracked)
    assert fit.timing is not None
    assert np.abs(fit.timing.readout - 0.1).max() < 0.005


def test_cameras_on_time_have_no_delays() -> None:
    """Catches delays that are fitted to noise and reported."""
    _, views = seen_views(SETTINGS, range(40))
    fit = fit_rig(rig_input(SETTINGS, views), untracked)
    assert fit.timing is None
    assert time_lines(fit, ("a", "b", "c"), 10.0) == []


def test_the_thickness_of_a_board_is_found() -> None:
    """Catches a camera that sees the back of a thick board and is placed nearer or farther by the thickness."""
    filming = Filming(thickness_m=0.006, backs=(1,))
    cameras, views = seen_views(SETTINGS, range(40), filming=filming)
    fit = fit_rig(rig_input(SETTINGS, views), untracked)
    assert fit.thickness_m == pytest.approx(0.006, abs=0.0005)
    assert largest_differences(fit.cameras, cameras)[2] < 0.2


def test_shared_errors_of_an_image_do_not_bend_the_rig() -> None:
    """Catches standard deviations that treat the errors of all corners of a displaced board as independent."""
    filming = Filming(jitter=0.02)
    cameras, views = seen_views(SETTINGS, range(40), filming=filming)
    fit = fit_rig(rig_input(SETTINGS, views), untracked)
    focal, degrees, _ = largest_differences(fit.cameras, cameras)
    assert focal < 0.2
    assert degrees < 0.5
    # The errors of the poses differ from the reported standard deviations by at most a factor of 3.
    assert np.degrees(fit.std[1:, :3]).max() > degrees / 6
