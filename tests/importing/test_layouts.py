"""Tests of the search for calibrations: the folders of motion capture programs, and reasons for refused files."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.recording.capture.calibration import write_calibration
from fourd.recording.importing.detection import pick_format
from fourd.recording.importing.imported import Imported
from tests.importing.formats.sources import uneven_cameras, write_pictures, write_video
from tests.importing.formats.test_anipose import calibration_toml


def read(source: Path) -> tuple[str, Imported]:
    found = pick_format(None, source)
    return found.name, found.read(source)


def write_videos(folder: Path, names: tuple[str, ...] = ("camA", "camB", "camC")) -> None:
    for name in names:
        write_video(folder / f"{name}.mp4")


def write_toml(path: Path, text: str | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(calibration_toml(1) if text is None else text)


def caliscope_toml(names: tuple[str, ...] = ("0", "1", "2")) -> str:
    text = ""
    for name, camera in zip(names, uneven_cameras(3), strict=True):
        text += f"[cameras.{name}]\ncam_id = {name}\nignore = false\nsize = [{camera.width}, {camera.height}]\n"
        text += f"matrix = {camera.intrinsics.tolist()}\ndistortions = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
        text += f"rotation = {camera.rotation.tolist()}\ntranslation = {camera.translation.tolist()}\n\n"
    return text


def pose2sim(root: Path) -> Path:
    write_toml(root / "calibration" / "Calib_board.toml")
    write_pictures(root / "calibration" / "intrinsics" / "camA", ["1.jpg"])
    write_videos(root / "trial" / "videos")
    return root


def freemocap(root: Path) -> Path:
    write_toml(
        root / "session_camera_calibration.toml",
        calibration_toml(1).replace("camA", "cam_0").replace("camB", "cam_1").replace("camC", "cam_2"),
    )
    write_videos(
        root / "synchronized_videos", ("Camera_000_synchronized", "Camera_001_synchronized", "Camera_002_synchronized")
    )
    write_videos(root / "annotated_videos", ("Camera_000", "Camera_001", "Camera_002"))
    return root


def anipose_session(root: Path) -> Path:
    write_toml(root / "calibration" / "calibration.toml", re.sub(r'"cam([ABC])"', r'"\1"', calibration_toml(1)))
    write_videos(root / "calibration", ("board-camA", "board-camB", "board-camC"))
    write_videos(root / "videos-raw", ("2019-08-02-vid01-camA", "2019-08-02-vid01-camB", "2019-08-02-vid01-camC"))
    return root


def caliscope(root: Path) -> Path:
    write_toml(root / "camera_array.toml", caliscope_toml())
    write_videos(root / "calibration" / "extrinsic", ("cam_0", "cam_1", "cam_2"))
    write_videos(root / "recordings" / "walk", ("cam_0", "cam_1", "cam_2"))
    return root


def easymocap_board(root: Path) -> Path:
    write_calibration(root / "extri_data", ("camA", "camB", "camC"), uneven_cameras(3))
    write_pictures(root / "extri_data" / "images" / "camA", ["000000.jpg"])
    for name in ("camA", "camB", "camC"):
        write_pictures(root / "walk" / "images" / name, ["000000.jpg"])
    return root


@pytest.mark.parametrize(
    ("make", "trial", "name"),
    [
        (pose2sim, "trial", "anipose"),
        (pose2sim, "trial/videos", "anipose"),
        (freemocap, "synchronized_videos", "anipose"),
        (anipose_session, "videos-raw", "anipose"),
        (caliscope, "recordings/walk", "caliscope"),
        (easymocap_board, "walk", "easymocap"),
    ],
)
def test_calibrations_in_other_folders_are_found(tmp_path: Path, make, trial: str, name: str) -> None:  # type: ignore[no-untyped-def]
    """Catches an import that ignores the calibration of a layout and calibrates from the images. Also catches an import
    of the board videos instead of the recording."""
    root = make(tmp_path / "session")
    for source in (root, root / trial):
        found, imported = read(source)
        assert found == name
        assert len(imported.cameras) == 3
        assert all(camera.calibration is not None for camera in imported.cameras)
        frames = str(imported.cameras[0].frames)
        assert "calibration" not in frames.replace(str(tmp_path), "")
        assert "annotated" not in frames


@pytest.mark.parametrize("pattern", ["walk_{}.mp4", "{}.mp4", "{}-walk.mov", "GX010001.mp4", "subject-1 {}.mp4"])
@pytest.mark.parametrize("place", [".", "calibration", "../calibration"])
def test_one_folder_per_camera(pattern: str, place: str, tmp_path: Path) -> None:
    """Catches a recording with one folder per camera that is taken for several recordings."""
    session = tmp_path / "session"
    write_toml(session / place / "calibration.toml")
    for name in ("camA", "camB", "camC"):
        write_video(session / name / pattern.format(name))
    found, imported = read(session)
    assert found == "anipose"
    assert [camera.name for camera in imported.cameras] == ["camA", "camB", "camC"]
    assert all(camera.calibration is not None for camera in imported.cameras)
    assert all(camera.name in str(camera.frames) for camera in imported.cameras)


def test_several_videos_in_the_folder_of_a_camera(tmp_path: Path) -> None:
    """Catches a session of several recordings of which the last one is imported."""
    write_toml(tmp_path / "calibration.toml")
    for name in ("camA", "camB", "camC"):
        write_video(tmp_path / name / f"walk_{name}.mp4")
        write_video(tmp_path / name / f"run_{name}.mp4")
    with pytest.raises(UserError, match=r"expected one recording, got 3: .*camA"):
        pick_format(None, tmp_path)


def test_calibrations_without_a_recording_are_named(tmp_path: Path) -> None:
    """Catches a project whose calibration is found without a word, because the recording is missing."""
    root = caliscope(tmp_path / "project")
    shutil.rmtree(root / "recordings")
    message = (
        f"{root}: expected a recording beside the calibration {root}/camera_array.toml (caliscope, 3 cameras), got no "
        "videos or images outside the folders of calibrations; add the recording's videos cam_0.mp4, cam_1.mp4, "
        f"cam_2.mp4 in {root}/recordings/NAME/"
    )
    with pytest.raises(UserError, match=re.escape(message)):
        pick_format(None, root)
    root = anipose_session(tmp_path / "session")
    shutil.rmtree(root / "videos-raw")
    with pytest.raises(UserError, match=r"beside the calibration .*/calibration.toml \(anipose, 3 cameras\), got no"):
        pick_format(None, root)


def test_several_recordings_are_named(tmp_path: Path) -> None:
    """Catches an import that chooses one of several recordings instead of reporting an error."""
    root = pose2sim(tmp_path)
    write_videos(root / "second" / "videos")
    with pytest.raises(UserError, match=r"expected one recording, got 2: .*second, .*trial; name one of them"):
        pick_format(None, root)
    assert read(root / "second")[0] == "anipose"


def test_files_that_are_not_taken_have_reasons(tmp_path: Path) -> None:
    """Catches a calibration that is ignored without a message, and a pickle that is loaded."""
    write_videos(tmp_path / "videos")
    (tmp_path / "calib.pickle").write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    (tmp_path / "Calib.toml").write_text("[int_cam]\nmatrix = 1\n")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "intri.yml").write_text("%YAML:1.0\n")
    name, imported = read(tmp_path)
    assert name == "videos"
    notes = "\n".join(imported.notes)
    assert "calib.pickle (fourd never loads pickles, because loading one can run code)" in notes
    assert "Calib.toml (no table of a camera with matrix, rotation and translation)" in notes
    assert "intri.yml (no extri.yml beside it)" in notes


def test_a_calibration_of_other_cameras_is_an_error(tmp_path: Path) -> None:
    """Catches an import that calibrates from the images because the camera names in the calibration do not fit."""
    root = pose2sim(tmp_path)
    shutil.rmtree(root / "trial")
    write_videos(root / "trial" / "videos", ("left", "right", "top"))
    with pytest.raises(
        UserError, match=r"got none that fits: .*Calib_board.toml \(.*expected calibrations with the na.*"
    ):
        pick_format(None, root)
    assert pick_format("videos", root / "trial").name == "videos"


def test_intrinsics_alone_are_refused(tmp_path: Path) -> None:
    """Catches an unfinished calibration of Caliscope that is read with zero poses."""
    write_videos(tmp_path / "videos", ("cam_0", "cam_1", "cam_2"))
    write_toml(tmp_path / "camera_array.toml", re.sub("(?m)^translation.*$", "", caliscope_toml()))
    with pytest.raises(UserError, match=r"expected rotation and translation, got only intrinsics; calibrate the poses"):
        read(tmp_path)


def test_two_calibrations_of_one_format_need_a_choice(tmp_path: Path) -> None:
    """Catches an arbitrary choice between two calibrations."""
    root = pose2sim(tmp_path)
    write_toml(root / "calibration" / "Calib_scene.toml")
    with pytest.raises(UserError, match=r"expected one calibration, got .*board.toml and .*scene.toml; name the file"):
        pick_format(None, root)
    shutil.copytree(root / "trial" / "videos", root / "videos")
    name, imported = read(root / "calibration" / "Calib_scene.toml")
    assert name == "anipose"
    assert imported.notes[0].endswith("Calib_scene.toml")


def test_opencap_sessions_are_refused_without_loading_pickles(tmp_path: Path) -> None:
    """Catches an import that runs code in a pickle, and a message that does not say how to convert the session."""
    path = tmp_path / "Videos" / "Cam0" / "cameraIntrinsicsExtrinsics.pickle"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    with pytest.raises(
        UserError, match=r"got OpenCap's pickle, which fourd never loads.*docs/importing.md \(OpenCap\)"
    ):
        pick_format(None, tmp_path)


def test_two_recordings_in_one_folder_are_refused(tmp_path: Path) -> None:
    """Catches an import that treats the videos of a second recording as additional cameras."""
    root = anipose_session(tmp_path)
    write_videos(root / "videos-raw", ("2019-08-02-vid02-camA",))
    with pytest.raises(UserError, match=r"expected one video of camera 'A', got .*vid01-camA, .*vid02-camA"):
        pick_format(None, root)
