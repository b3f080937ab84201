"""Tests that imports of phone videos give the same images as imports of videos without rotation, uneven frame times or
HDR.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.recording.capture import Capture, open_capture, write_calibration
from fourd.recording.capture.check import check_capture
from fourd.recording.importing.frame_geometry import turn_camera
from tests.capture.phone_videos import moving_picture, write_phone_video
from tests.captures import ring_cameras
from tests.importing.test_importer import run_import

NTSC = Fraction(30000, 1001)
PLAIN = [frame / 30 for frame in range(20)]
NAMES = ("a", "b", "c")


def psnr(ours: np.ndarray, truth: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(ours.astype(np.float64) - truth).mean() / 255**2))


def mean_psnr(capture: Capture, rate: Fraction | int = 30) -> list[float]:
    """Mean PSNR of each camera's images against the moving picture at the times of the capture's frames."""
    return [
        float(np.mean([psnr(capture.image(camera, k), moving_picture(float(k / rate))) for k in range(0, 16, 5)]))
        for camera in range(len(capture.names))
    ]


def calibrations(width: int = 64, height: int = 48) -> list[Camera]:
    return [replace(camera, width=width, height=height) for camera in ring_cameras(3, 64)]


def write_source(folder: Path, cameras: Sequence[Camera] | None = None) -> Path:
    """Write the calibration and three plain videos."""
    write_calibration(folder, NAMES, list(cameras or calibrations()))
    for name in NAMES:
        write_phone_video(folder / "videos" / f"{name}.mp4", PLAIN)
    return folder


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> list[float]:
    folder = tmp_path_factory.mktemp("plain")
    run_import(write_source(folder / "source"), folder / "out")
    return mean_psnr(open_capture(folder / "out"))


@pytest.mark.parametrize("unpack", [False, True])
def test_turned_videos_give_the_same_pictures(unpack: bool, plain: list[float], tmp_path: Path) -> None:
    """Catches a rotation in the wrong direction, and code that decodes frames without applying their rotation."""
    source = write_source(tmp_path / "source")
    for name, clockwise in zip(NAMES, (90, 180, 270), strict=True):
        write_phone_video(source / "videos" / f"{name}.mp4", PLAIN, clockwise=clockwise)
    lines = run_import(source, tmp_path / "out", unpack=unpack)
    capture = open_capture(tmp_path / "out")
    assert [(camera.width, camera.height) for camera in capture.cameras] == [(64, 48)] * 3
    assert min(mean_psnr(capture)) > plain[0] - 0.3
    for name, angle in zip(NAMES, (90, 180, 270), strict=True):
        assert f"{name}: frames are turned {angle} degrees clockwise (rotation metadata)" in lines
    assert "a, c: the calibration belongs to the turned frames (its images are 64 x 48)" in lines
    reason = "stored and turned frames have its orientation; change this with --calibrated-frames stored"
    assert f"b: the calibration belongs to the turned frames ({reason})" in lines
    for ours, theirs in zip(capture.cameras, calibrations(), strict=True):
        assert np.allclose(ours.intrinsics, theirs.intrinsics)


def test_calibrations_of_stored_frames_are_turned(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a calibration of the stored frames that is used for the rotated frames."""
    upright = [replace(camera, distortion=rng.normal(0, 0.02, 12)) for camera in calibrations()]
    stored = [turn_camera(camera, angle) for camera, angle in zip(upright, (90, 180, 270), strict=True)]
    source = write_source(tmp_path / "source", stored)
    for name, clockwise in zip(NAMES, (90, 180, 270), strict=True):
        write_phone_video(source / "videos" / f"{name}.mp4", PLAIN[:3], clockwise=clockwise)
    lines = run_import(source, tmp_path / "out", calibrated_frames="stored")
    text = "a, b, c: the calibration belongs to the stored frames (--calibrated-frames stored), so it is turned too"
    assert text in lines
    found = open_capture(tmp_path / "out")
    for ours, theirs in zip(found.distorted_cameras, upright, strict=True):
        for value in ("intrinsics", "rotation", "translation", "distortion"):
            assert np.allclose(getattr(ours, value), getattr(theirs, value))
    lines = run_import(source, tmp_path / "auto")
    assert any(
        line.startswith("a, c: the calibration belongs to the stored frames (its images are 48 x 64)") for line in lines
    )


def test_turned_cameras_project_to_turned_pixels(rng: np.random.Generator) -> None:
    """Catches a sign error in the rotated pose, intrinsics or tangential distortion."""
    cv2 = pytest.importorskip("cv2")
    camera = replace(calibrations()[0], distortion=rng.normal(0, 0.05, 12))
    points = rng.normal(0, 0.4, (20, 3))

    def project(of: Camera) -> np.ndarray:
        rotation = cv2.Rodrigues(of.rotation)[0]
        return np.asarray(cv2.projectPoints(points, rotation, of.translation, of.intrinsics, of.distortion)[0][:, 0])

    x, y = project(camera).T
    assert np.allclose(project(turn_camera(camera, 90)), np.stack([y, camera.width - x], axis=1))
    assert np.allclose(project(turn_camera(camera, 180)), np.stack([camera.width - x, camera.height - y], axis=1))
    assert np.allclose(project(turn_camera(camera, 360)), project(camera))


def test_uneven_times_give_the_pictures_of_their_times(
    plain: list[float], tmp_path: Path, rng: np.random.Generator
) -> None:
    """Catches frames that are selected by number instead of time, which is wrong if a frame is missing or if frame
    times jitter."""
    source = write_source(tmp_path / "source")
    jitter = np.array([0, *rng.uniform(-0.002, 0.002, 20)])
    times = [frame / 30 + float(jitter[frame]) for frame in range(21) if frame != 8]
    write_phone_video(source / "videos" / "b.mp4", times)
    lines = run_import(source, tmp_path / "out")
    capture = open_capture(tmp_path / "out")
    assert capture.frame_count == 20
    assert capture.fps == pytest.approx(30, rel=2e-3)
    assert mean_psnr(capture)[1] > plain[1] - 0.3
    assert "b: uneven frame times; frames are picked by their times" in lines
    assert any(line.startswith("largest error of the frame times: 3") and "(b, frame 8)" in line for line in lines)


def test_different_rates_share_the_lowest(plain: list[float], tmp_path: Path) -> None:
    """Catches cameras at 29.97 and 60 frames per second that are paired by frame numbers."""
    source = write_source(tmp_path / "source")
    write_phone_video(source / "videos" / "a.mp4", [float(k / NTSC) for k in range(20)], fps=NTSC)
    write_phone_video(source / "videos" / "b.mp4", [k / 60 for k in range(40)], fps=60)
    write_phone_video(source / "videos" / "c.mp4", [k / 60 for k in range(50)], fps=60)
    lines = run_import(source, tmp_path / "out", offsets={"c": 5.5})
    capture = open_capture(tmp_path / "out")
    assert capture.fps == pytest.approx(30000 / 1001)
    assert capture.frame_count == check_capture(tmp_path / "out").frames == 20
    assert "3 videos; the capture has 29.97 frames per second" in lines
    assert "videos with other rates, whose frames are picked by their times: b 60, c 60 frames per second" in lines
    assert any(line.startswith("largest error of the frame times: ") for line in lines)
    assert min(mean_psnr(capture, NTSC)[:2]) > plain[0] - 0.3
    late = [psnr(capture.image(2, k), moving_picture(float((k + 5.5) / NTSC))) for k in (0, 6, 12)]
    assert np.mean(late) > plain[0] - 0.3


@pytest.mark.parametrize("transfer", ["HLG", "PQ"])
def test_hdr_videos_give_the_same_pictures(transfer: str, plain: list[float], tmp_path: Path) -> None:
    """Catches HDR video that is shown grey and flat because its transfer function is ignored."""
    source = write_source(tmp_path / "source")
    for name in NAMES:
        write_phone_video(source / "videos" / f"{name}.mp4", PLAIN, transfer=transfer)
    lines = run_import(source, tmp_path / "out")
    assert min(mean_psnr(open_capture(tmp_path / "out"))) > plain[0] - 0.3
    assert sum("is tone-mapped to sRGB" in line for line in lines) == 1
    assert any(line.startswith(f"a, b, c: HDR video ({transfer}, BT.2020)") for line in lines)


def test_large_videos_are_reduced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a reduced capture whose calibration is not reduced, and a value of --scale with two meanings."""
    source = write_source(tmp_path / "source")
    write_phone_video(source / "videos" / "a.mp4", PLAIN, clockwise=90)
    words = ["import", str(source), str(tmp_path / "out"), "--centres", "as-given"]
    assert main([*words, "--scale", "0.5"]) == 0
    capsys.readouterr()
    capture = open_capture(tmp_path / "out")
    for camera, full in zip(capture.cameras, calibrations(), strict=True):
        assert (camera.width, camera.height) == (32, 24)
        assert np.allclose(camera.intrinsics[:2], full.intrinsics[:2] / 2)
    small = moving_picture(0).reshape(24, 2, 32, 2, 3).mean(axis=(1, 3))
    assert min(psnr(capture.image(camera, 0), small) for camera in range(3)) > 33
    for value in ("0", "2", "x", "nan"):
        assert main([*words, "--scale", value]) == 2
        assert "--scale: expected CAM,CAM=METRES or a factor above 0 and at most 1" in capsys.readouterr().err
    assert main([*words, "--scale", "0.5", "--scale", "a,b=2"]) == 0


def test_images_are_not_reduced(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a factor that is ignored for images."""
    with pytest.raises(
        UserError, match=r"--scale 0.5: expected videos without masks, got masks of '.*image_scale: 0.5"
    ):
        run_import(ball_capture, tmp_path / "out", reduce=0.5)
