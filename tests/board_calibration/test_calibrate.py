"""``fourd calibrate`` on rendered videos with known truth: results, world frame, boards, and one-line errors."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.base.progress import untracked
from fourd.cli.main import main
from fourd.recording.board_calibration.adjustment.rig import Poses, RigState, project
from fourd.recording.board_calibration.detection import BoardDetector
from fourd.recording.board_calibration.diagnosis import suggest_fix
from fourd.recording.boards import CalibrationBoard, draw_board, write_board
from fourd.recording.capture.calibration import read_calibration
from fourd.recording.synth.board_render import BoardPose, BoardRenderer, Optics
from fourd.recording.synth.board_videos import BOARD, BoardSettings, board_pose, make_board_videos, rig_cameras
from tests.board_calibration.rigs import flat_corners, largest_differences
from tests.capture.numbered_videos import write_numbered_video

SETTINGS = BoardSettings(frames=24, cameras=3, size=400)
CHESSBOARD = CalibrationBoard(7, 6, 0.06)


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Videos of a ChArUco board by three cameras."""
    folder = tmp_path_factory.mktemp("board") / "videos"
    make_board_videos(folder, SETTINGS, untracked)
    return folder


def cameras_in(folder: Path) -> list[Camera]:
    return [each.camera(each.width or 0, each.height or 0) for each in read_calibration(folder).values()]


def calibrate(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The log of a successful calibration."""
    assert main(["calibrate", *map(str, words)]) == 0
    return capsys.readouterr().err


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The single error line of a calibration."""
    assert main(["calibrate", *map(str, words)]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("fourd calibrate: ")]
    assert len(lines) == 1
    return lines[0]


def test_a_rig_is_calibrated_from_videos(videos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a shift by half a pixel, a wrong unit, and missing results or reports."""
    out = tmp_path / "calibration"
    log = calibrate(capsys, videos, "--board", videos / "board.toml", "-o", out)
    assert "held-out frames measure the error" in log
    focal, degrees, position = largest_differences(cameras_in(out), cameras_in(videos / "truth"))
    assert focal < 0.3
    assert degrees < 0.3
    assert position < 0.3
    assert sorted(path.name for path in out.iterdir()) == ["extri.yml", "intri.yml", "report.json", "rig.png"]
    report = json.loads((out / "report.json").read_text())
    for camera in report["cameras"].values():
        assert camera["fit_px"] < 0.1
        assert camera["held_out_px"] < 0.15
        assert 0.2 < camera["coverage"] <= 1
    assert cv2.imread(str(out / "rig.png")).std() > 5


def test_the_floor_and_known_lenses(videos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a world frame that differs from the board's coordinate frame in the floor image, and known lenses that
    are changed."""
    out, truth = tmp_path / "calibration", cameras_in(videos / "truth")
    words = ["--intrinsics", videos / "truth", "--floor-frame", 5, "--frames", "0:24:2"]
    calibrate(capsys, videos, "--board", videos / "board.toml", "-o", out, *words)
    pose = board_pose(SETTINGS, 5.0)
    for found, true in zip(cameras_in(out), truth, strict=True):
        assert np.allclose(found.intrinsics, true.intrinsics, atol=1e-9)
        assert np.abs(found.centre - pose.rotation.T @ (true.centre - pose.translation)).max() < 0.005
        assert found.centre[2] > 0


def test_the_calibration_is_replaced_as_a_whole(
    videos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a calibration that overwrites other files, and a failed calibration that leaves incomplete results."""
    out = tmp_path / "calibration"
    words = [
        videos,
        "--board",
        videos / "board.toml",
        "-o",
        out,
        "--intrinsics",
        videos / "truth",
        "--frames",
        "0:24:3",
    ]
    calibrate(capsys, *words)
    before = (out / "extri.yml").read_bytes()
    assert "--floor-frame: expected 0 to 23" in refused(capsys, *words, "--floor-frame", 24)
    assert (out / "extri.yml").read_bytes() == before
    calibrate(capsys, *words, "--floor-frame", 3)
    assert (out / "extri.yml").read_bytes() != before
    (out / "notes.txt").write_text("mine")
    assert "a folder with other files; name another folder" in refused(capsys, *words)
    assert (out / "notes.txt").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["calibration", "calibration.1"]
    assert (tmp_path / "calibration.1" / "extri.yml").read_bytes() == before


@pytest.mark.parametrize(
    "board",
    [
        replace(BOARD, inverted=True, double_sided=True),
        replace(BOARD, double_sided=True),
    ],
)
def test_both_sides_of_a_board_have_the_same_corners(board: CalibrationBoard) -> None:
    """Catches corners of the back that are mirrored, shifted, or have the ids of other corners."""
    settings = BoardSettings(size=500, board=board)
    front = rig_cameras(settings)[1]
    tilt = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) @ cv2.Rodrigues(np.array([0.2, -0.3, 0.1]))[0]
    pose = BoardPose(tilt, -tilt @ (board.size_m[0] / 2, board.size_m[1] / 2, 0.0))
    behind = tilt @ np.diag([-1.0, 1.0, -1.0]) @ tilt.T
    # Half a turn about the board's vertical axis, which passes through the origin, moves the camera to the back.
    back = replace(front, rotation=front.rotation @ behind)
    for camera in (front, back):
        picture = BoardRenderer(board, camera, Optics(0.6, 1.0)).render([pose], np.random.default_rng(0))
        view = BoardDetector(board).detect(picture, 0, 0)
        assert view is not None
        assert len(view.corners) >= board.corner_count - 2
        state = RigState((camera,), Poses(pose.rotation[None], pose.translation[None]))
        true = project(state, flat_corners(board.corners[view.corners], view.pixels)).pixels
        assert np.abs(view.pixels - true).max() < 0.15


def test_a_chessboard_in_folders_of_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a chessboard whose corners change their order between cameras, images that are not found, and camera
    names that OpenCV cannot write, after the whole fit."""
    settings = BoardSettings(frames=14, cameras=2, size=320, board=CHESSBOARD)
    cameras = rig_cameras(settings)
    for name, camera in zip(("cam.1", "左: [2]"), cameras, strict=True):
        renderer = BoardRenderer(CHESSBOARD, camera, settings.optics)
        (tmp_path / "images" / name).mkdir(parents=True)
        for frame in range(14):
            picture = renderer.render([board_pose(settings, 3.0 * frame)], np.random.default_rng(frame))
            assert cv2.imwrite(str(tmp_path / "images" / name / f"{frame:06d}.png"), picture)
    write_board(tmp_path / "board.toml", CHESSBOARD)
    calibrate(capsys, tmp_path, "--board", tmp_path / "board.toml", "-o", tmp_path / "out")
    focal, degrees, position = largest_differences(cameras_in(tmp_path / "out"), cameras)
    assert focal < 1.0
    assert degrees < 0.6
    assert position < 1.0


@pytest.mark.parametrize(
    ("changes", "fix"),
    [
        ({"columns": 5, "rows": 7}, "columns = 7, rows = 5"),
        ({"inverted": True}, "inverted = false"),
        ({"marker_m": None, "dictionary": None, "rows": 6}, 'pattern = "charuco", dictionary = "DICT_4X4_50"'),
    ],
)
def test_the_board_in_the_images_is_recognised(changes: dict[str, object], fix: str) -> None:
    """Catches an error message that suggests a board other than the one in the videos."""
    camera = rig_cameras(SETTINGS)[1]
    renderer = BoardRenderer(BOARD, camera, SETTINGS.optics)
    pictures = [renderer.render([board_pose(SETTINGS, 9.0)], np.random.default_rng(0))]
    assert suggest_fix(replace(BOARD, **changes), pictures) == fix


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dictionary": "DICT_6X6_50"}, 'the images show a board with dictionary = "DICT_4X4_50"; correct'),
        ({"marker_m": 0.048}, "board.toml: marker_m: expected 0.7"),
    ],
)
def test_a_board_that_does_not_fit_is_named(
    changes: dict[str, object], message: str, videos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a wrong board description that causes an error without a hint, or a wrong calibration without an
    error.
    """
    write_board(tmp_path / "board.toml", replace(BOARD, **changes))
    out = tmp_path / "out"
    line = refused(capsys, videos, "--board", tmp_path / "board.toml", "-o", out, "--frames", "0:24:6")
    assert message in line
    assert str(tmp_path / "board.toml") in line
    assert not out.exists()


def write_images(folder: Path, name: str, pictures: list[np.ndarray]) -> None:
    (folder / name).mkdir(parents=True)
    for number, picture in enumerate(pictures):
        assert cv2.imwrite(str(folder / name / f"{number:06d}.png"), picture)


def test_boards_that_are_not_seen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches videos without a board, and a board that only one camera sees, for which no error is reported."""
    empty = [np.full((120, 160), 90 + 10 * number, np.uint8) for number in range(4)]
    board = CalibrationBoard(4, 3, 0.05, 0.04, "DICT_4X4_50")
    drawn = [np.roll(draw_board(board, 30, margin=30), 3 * shift, axis=1) for shift in range(4)]
    write_board(tmp_path / "board.toml", board)
    words = ["--board", tmp_path / "board.toml", "-o", tmp_path / "out"]
    write_images(tmp_path / "none", "a", empty)
    write_images(tmp_path / "none", "b", empty)
    line = refused(capsys, tmp_path / "none", *words)
    assert "none: expected a ChArUco board (DICT_4X4_50) of 4 x 3 squares of 50 mm" in line
    assert "got none in a, b; film the whole board" in line
    write_images(tmp_path / "one", "a", drawn)
    write_images(tmp_path / "one", "b", empty)
    assert "one: expected two cameras that see the board, got only a" in refused(capsys, tmp_path / "one", *words)
    write_images(tmp_path / "short", "a", drawn)
    write_images(tmp_path / "short", "b", drawn[:1])
    assert "short/b: expected at least 3 frames of a moving board, got 1" in refused(capsys, tmp_path / "short", *words)
    for name in ("a", "b"):
        write_numbered_video(tmp_path / "video" / f"{name}.mp4", range(1))
    assert "a.mp4: expected a video of at least 2 frames, got 1" in refused(capsys, tmp_path / "video", *words)
    write_images(tmp_path / "single", "a", drawn)
    assert "a: expected videos of at least two cameras, got one" in refused(capsys, tmp_path / "single", *words)
    assert "gone: expected a folder with videos of the board" in refused(capsys, tmp_path / "gone", *words)
    assert not (tmp_path / "out").exists()


LENS = "size = [400, 400]\nmatrix = [[400, 0, 200], [0, 400, 200], [0, 0, 1]]\ndistortions = [0, 0, 0, 0, 0]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"[cameras.0]\n{LENS}[cameras.9]\n{LENS}", "expected cameras among cam00, cam01, cam02, got '9'; rename"),
        (f"[x]\n{LENS}", "expected calibrations with the names of the cameras"),
        (f"[cameras.0]\n{LENS.replace('[400, 400]', '[640, 360]')}", "cam00: expected a lens for images of 400 x 400"),
        ("[cameras.0]\nsize = [400, 400]\n", "expected a table with size, matrix and distortions for each camera"),
        ("[cameras.0]\nsize = [400, 400]\nmatrix = 1\n", "[cameras.0]: expected size, matrix and distortions"),
        (f"[cameras.0]\n{LENS.replace('400, 0, 200', '400, 0, nan')}", "[cameras.0]: matrix: expected finite numbers"),
        ("cameras = [", "expected TOML or a folder with intri.yml"),
    ],
)
def test_wrong_lenses_are_one_line(
    text: str, message: str, videos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a lens of an unknown camera or of another image size that is silently ignored or used."""
    lenses = tmp_path / "lenses.toml"
    lenses.write_text(text)
    words = ["--board", videos / "board.toml", "-o", tmp_path / "out", "--intrinsics", lenses]
    line = refused(capsys, videos, *words)
    assert message in line
    assert str(lenses) in line
    assert not (tmp_path / "out").exists()


def test_lenses_of_caliscope_start_at_the_centre_of_a_pixel(
    videos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a principal point that is half a pixel off, a lens of the wrong camera, and a lens of another size."""
    truth = cameras_in(videos / "truth")
    tables = []
    for number in (2, 0):
        k = 2 * truth[number].intrinsics[:2]
        k[:, 2] -= 0.5
        distortion = truth[number].distortion
        assert distortion is not None
        tables.append(
            f"[cameras.{number}]\nsize = [800, 800]\nmatrix = {[*k.tolist(), [0.0, 0.0, 1.0]]}\n"
            f"distortions = {distortion.tolist()}\n"
        )
    (tmp_path / "camera_array.toml").write_text("".join(tables))
    words = ["--board", videos / "board.toml", "-o", tmp_path / "out", "--intrinsics", tmp_path / "camera_array.toml"]
    log = calibrate(capsys, videos, *words)
    assert "no lens for cam01; these lenses are estimated from the board" in log
    found = cameras_in(tmp_path / "out")
    for number in (0, 2):
        assert np.allclose(found[number].intrinsics, truth[number].intrinsics, atol=1e-9)


def test_missing_arguments_are_named(videos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a command without an output that fails after the detection."""
    assert "got no -o CALIBRATION; add it" in refused(capsys, videos, "--board", videos / "board.toml")
    assert "got no VIDEOS; add it" in refused(capsys, "--board", videos / "board.toml", "-o", tmp_path / "out")
    words = [videos, "--board", videos / "board.toml", "-o", tmp_path / "out", "--offset", "cam7=2"]
    assert "--offset: expected cameras among cam00, cam01, cam02, got 'cam7'" in refused(capsys, *words)


def test_the_import_takes_the_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an import whose cameras differ from the given calibration, and a calibration that is ignored."""
    videos, renamed = tmp_path / "videos", tmp_path / "renamed"
    make_board_videos(videos, BoardSettings(frames=3, cameras=2, size=128), untracked)
    renamed.mkdir()
    for number in range(2):
        shutil.copy(videos / "videos" / f"cam{number:02d}.mp4", renamed / f"view{number}.mp4")
    out = tmp_path / "capture"
    assert main(["import", str(renamed), str(out), "--calibration", str(videos / "truth")]) == 0
    for found, true in zip(cameras_in(out), cameras_in(videos / "truth"), strict=True):
        assert np.allclose(found.rotation, true.rotation, atol=1e-9)
        assert np.allclose(found.intrinsics, true.intrinsics, atol=1e-9)
    capsys.readouterr()
    other = tmp_path / "other"
    assert main(["import", str(renamed), str(other), "--calibration", str(tmp_path / "gone")]) == 2
    assert "gone/intri.yml: expected the cameras' calibration, got no such file" in capsys.readouterr().err
    words = ["import", "anipose", str(renamed), str(other), "--calibration", str(videos / "truth")]
    assert main(words) == 2
    words = ["import", str(renamed), str(other), "--calibration", str(videos / "truth"), "--calibrate"]
    assert main(words) == 2
    assert "--calibrate: expected no --calibration" in capsys.readouterr().err
    shutil.copy(renamed / "view1.mp4", renamed / "view7.mp4")
    assert main(["import", str(renamed), str(other), "--calibration", str(videos / "truth")]) == 2
    assert "expected a calibration of each camera, got none for view7" in capsys.readouterr().err
    assert not other.exists()


@pytest.mark.slow
def test_default_videos_meet_the_accuracy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a loss of accuracy of the corners or of the adjustment, with blur, noise and unknown lenses."""
    assert main(["synth", str(tmp_path / "videos"), "--board"]) == 0
    board = tmp_path / "videos" / "board.toml"
    calibrate(capsys, tmp_path / "videos", "--board", board, "-o", tmp_path / "out")
    truth = cameras_in(tmp_path / "videos" / "truth")
    focal, degrees, position = largest_differences(cameras_in(tmp_path / "out"), truth)
    assert focal < 0.2
    assert degrees < 0.05
    assert position < 0.2


def test_a_pose_from_behind_shows_no_pattern() -> None:
    """Catches a single-sided board whose back shows the pattern."""
    settings = BoardSettings(size=300)
    pose = board_pose(settings, 4.0)
    behind = BoardPose(pose.rotation @ np.diag([-1.0, 1.0, -1.0]), pose.translation)
    picture = BoardRenderer(BOARD, rig_cameras(settings)[1], Optics(0.6, 0.5)).render(
        [behind], np.random.default_rng(0)
    )
    assert picture.min() > 80
