"""Opening and checking of captures: their content, the memory and time that they need, and the errors for damaged
captures.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.capture import open_capture, read_calibration, write_calibration
from fourd.recording.capture.check import check_capture
from fourd.recording.capture.focus import find_focus
from tests.captures import ring_cameras

BARREL = np.array([-0.25, 0.06, 0.002, -0.001, 0.01])


@pytest.fixture
def capture(ball_capture: Path, tmp_path: Path) -> Path:
    """A copy of the capture that the test damages."""
    return Path(shutil.copytree(ball_capture, tmp_path / "capture"))


def edit(path: Path, pattern: str, replacement: str) -> None:
    text, count = re.subn(pattern, replacement, path.read_text(), count=1)
    assert count == 1
    path.write_text(text)


def test_selection_of_views_and_frames(ball_capture: Path) -> None:
    """Catches a selection that renumbers the frames, which would change the times of the frames."""
    capture = open_capture(ball_capture, views=["05", "01"], frames="1:3")
    assert capture.names == ("01", "05")
    assert capture.frame_numbers == (1, 2)
    assert [capture.time(0), capture.time(1)] == [0.5, 1.0]
    assert open_capture(ball_capture, frames="0:3:2").frame_numbers == (0, 2)
    assert open_capture(ball_capture, frames="2:").frame_numbers == (2,)
    assert open_capture(ball_capture, frames="0:1").time(0) == 0


def test_pictures_are_rgb_and_mattes_grey(ball_capture: Path) -> None:
    """Catches images in OpenCV's BGR order."""
    capture = open_capture(ball_capture)
    stored = cv2.imread(str(ball_capture / "images" / "02" / "000001.png"))
    assert stored is not None
    assert np.array_equal(capture.image(2, 1), stored[..., ::-1])
    assert capture.mask(2, 1).shape == (64, 64)
    assert capture.mask(2, 1).max() == 255


def test_scaled_pictures_fit_their_cameras(ball_capture: Path) -> None:
    """Catches intrinsics that are not scaled with the image."""
    whole, half = open_capture(ball_capture), open_capture(ball_capture, scale=0.5)
    assert half.image(0, 0).shape == (32, 32, 3)
    point = np.array([[0.1, 0.05, 0.2]])
    assert np.allclose(half.cameras[0].project(point)[0] * 2, whole.cameras[0].project(point)[0])


def test_memory_is_bounded(ball_capture: Path) -> None:
    """Catches a cache that keeps all frames of a capture with thousands of frames."""
    capture = open_capture(ball_capture, cache_mb=0)
    for camera in range(8):
        for frame in range(3):
            capture.image(camera, frame)
            capture.mask(camera, frame)
    assert not capture._cache._arrays
    capture = open_capture(ball_capture)
    assert capture.image(0, 0) is capture.image(0, 0)


def write_dots(folder: Path, camera: Camera, xyz: np.ndarray) -> None:
    """Write an image with lens distortion that shows a soft dot for each point ``xyz``. The matte is the same image."""
    assert camera.distortion is not None
    rotation = cv2.Rodrigues(camera.rotation)[0]
    pixels, _ = cv2.projectPoints(xyz, rotation, camera.translation, camera.intrinsics, camera.distortion)
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    picture = np.zeros((camera.height, camera.width))
    for x, y in pixels[:, 0]:
        picture += np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 2.0**2))
    content = (255 * picture.clip(0, 1)).astype(np.uint8)
    for kind in ("images", "masks"):
        (folder / kind / "00").mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / kind / "00" / "000000.png"), content)
    write_calibration(folder, ["00"], [camera])


def test_undistortion_agrees_with_the_pinhole(tmp_path: Path) -> None:
    """Catches undistortion to intrinsics that differ from those of the cameras, and half-pixel shifts."""
    pinhole = ring_cameras(1, 200)[0]
    camera = Camera(pinhole.intrinsics, pinhole.rotation, pinhole.translation, 200, 160, BARREL)
    grid = np.stack(np.meshgrid([-0.5, 0, 0.5], [-0.6, 0.05, 0.6], [-0.4, 0.3]), axis=-1).reshape(-1, 3)
    for point in grid:
        write_dots(tmp_path, camera, point[None])
        capture = open_capture(tmp_path)
        assert capture.cameras[0].distortion is None
        expected, _ = capture.cameras[0].project(point[None])
        for picture in (capture.image(0, 0)[..., 1], capture.mask(0, 0)):
            weight = picture.astype(np.float64)
            rows, columns = np.indices(weight.shape) + 0.5
            found = np.array([(columns * weight).sum(), (rows * weight).sum()]) / weight.sum()
            assert np.abs(found - expected[0]).max() < 0.25


def test_calibration_round_trip(tmp_path: Path) -> None:
    """Catches precision or distortion lost in writing."""
    cameras = ring_cameras(3, 64)
    cameras[1] = Camera(cameras[1].intrinsics, cameras[1].rotation, cameras[1].translation, 80, 60, BARREL)
    write_calibration(tmp_path, ["a", "b", "c 1"], cameras)
    read = read_calibration(tmp_path)
    assert list(read) == ["a", "b", "c 1"]
    again = read["b"].camera(80, 60)
    assert again.distortion is not None
    assert np.allclose(again.distortion, BARREL, atol=1e-12)
    assert np.allclose(again.rotation, cameras[1].rotation, atol=1e-9)
    assert (read["b"].width, read["b"].height) == (80, 60)


def test_sizes_are_optional_and_rotations_may_be_vectors(capture: Path) -> None:
    """Catches a reader that refuses calibrations of EasyMocap's own tools, in which H, W and Rot are often missing."""
    intri, extri = capture / "intri.yml", capture / "extri.yml"
    intri.write_text(re.sub(r"(?m)^[HW]_\d\d: .*\n", "", intri.read_text()))
    rotations = r"(?m)^Rot_\d\d: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: \[[^\]]*\]\n"
    text, count = re.subn(rotations, "", extri.read_text())
    assert count == 8
    before = open_capture(capture).cameras
    extri.write_text(text)
    after = open_capture(capture).cameras
    assert (after[0].width, after[0].height) == (64, 64)
    assert all(np.allclose(a.rotation, b.rotation, atol=1e-9) for a, b in zip(before, after, strict=True))


def test_distortion_under_easymocaps_key(capture: Path) -> None:
    """Catches distortion coefficients that are ignored because EasyMocap's tools write the key dist_c instead of
    D_c."""
    intri = capture / "intri.yml"
    camera = replace(read_calibration(capture)["01"].camera(64, 64), distortion=BARREL)
    write_calibration(capture, ["01"], [camera])
    text, count = re.subn("D_01", "dist_01", intri.read_text())
    assert count == 1
    intri.write_text(text)
    assert np.allclose(read_calibration(capture)["01"].distortion, BARREL)


def _truncate_png(capture: Path) -> None:
    path = capture / "images" / "03" / "000001.png"
    path.write_bytes(path.read_bytes()[:-200])


def _truncate_jpeg(capture: Path) -> None:
    path = capture / "images" / "03" / "000001.png"
    whole = cv2.imread(str(path))
    assert whole is not None
    path.unlink()
    done, content = cv2.imencode(".jpg", whole)
    assert done
    path.with_suffix(".jpg").write_bytes(content.tobytes()[: len(content) // 2])


def _small_mask(capture: Path) -> None:
    cv2.imwrite(str(capture / "masks" / "04" / "000002.png"), np.full((32, 64), 255, np.uint8))


DAMAGES: list[tuple[str, Callable[[Path], object], str]] = [
    (
        "a missing picture in the middle",
        lambda c: (c / "images" / "02" / "000001.png").unlink(),
        r"images/02/000001.png: expected an image, since other cameras have this frame, got no such file; restore the",
    ),
    (
        "a missing matte",
        lambda c: (c / "masks" / "02" / "000001.png").unlink(),
        r"masks/02/000001.png: expected an image",
    ),
    (
        "a truncated PNG",
        _truncate_png,
        r"images/03/000001.png: expected a complete JPEG, PNG, .* image, got",
    ),
    (
        "a truncated JPEG",
        _truncate_jpeg,
        r"images/03/000001.jpg: expected a complete JPEG, PNG, .* image, got",
    ),
    (
        "text instead of a picture",
        lambda c: (c / "images" / "03" / "000001.png").write_text("hello"),
        r"000001.png: expected a complete JPEG, PNG, .* image, got another format; copy the file again",
    ),
    ("a mask of another size", _small_mask, r"masks/04/000002.png: expected 64 x 64 pixels.*got 64 x 32"),
    (
        "an invalid rotation",
        lambda c: edit(c / "extri.yml", r"(Rot_01: (?:.*\n){4}\s+data: \[ )[^,]*,", r"\g<1>9.0,"),
        r"extri.yml: camera '01': rotation: expected an orthonormal matrix",
    ),
    (
        "NaN in the intrinsics",
        lambda c: edit(c / "intri.yml", r"(K_03: (?:.*\n){4}\s+data: \[ )[^,]*,", r"\g<1>.Nan,"),
        r"intri.yml: K_03: expected finite numbers, got \[nan",
    ),
    (
        "a truncated matrix",
        lambda c: edit(c / "intri.yml", r"(K_03: (?:.*\n){4}\s+data: \[ )[^,]*,", r"\g<1>"),
        r"intri.yml: K_03: expected a complete matrix, got a truncated one; copy",
    ),
    (
        "a matrix without a number of rows",
        lambda c: edit(c / "intri.yml", r"(K_03: !!opencv-matrix\n)\s+rows: 3\n", r"\1"),
        r"intri.yml: K_03: expected a complete matrix, got a truncated one; copy",
    ),
    (
        "a matrix with a negative number of columns",
        lambda c: edit(c / "extri.yml", r"(T_01: (?:.*\n)\s+rows: )3(\n\s+cols: )1", r"\g<1>-1\g<2>-3"),
        r"extri.yml: T_01: expected a complete matrix, got a truncated one; copy",
    ),
    (
        "a camera in intri.yml without pictures",
        lambda c: shutil.rmtree(c / "images" / "06"),
        r"images/06: expected images of camera '06', which is in intri.yml, got none",
    ),
    (
        "pictures without calibration",
        lambda c: shutil.copytree(c / "images" / "06", c / "images" / "99"),
        r"intri.yml: expected camera '99', since images/99 exists",
    ),
    (
        "no extrinsics",
        lambda c: (c / "extri.yml").unlink(),
        r"extri.yml: expected the cameras' calibration, got no such file",
    ),
    (
        "a calibration that is no FileStorage",
        lambda c: (c / "intri.yml").write_text("K: [1, 2"),
        r"intri.yml: ",
    ),
    (
        "two pictures of one frame",
        lambda c: shutil.copy(c / "images" / "01" / "000000.png", c / "images" / "01" / "000000.jpg"),
        r"images/01/000000.png: expected one image per frame",
    ),
]


@pytest.mark.parametrize(("damage", "message"), [case[1:] for case in DAMAGES], ids=[case[0] for case in DAMAGES])
def test_broken_captures_raise_one_line(
    damage: Callable[[Path], object], message: str, capture: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Catches a damaged capture that causes a traceback, a half-grey image, or a message that does not name the
    file.
    """
    damage(capture)
    with pytest.raises(UserError, match=message) as caught:
        opened = open_capture(capture)
        for camera in range(len(opened.names)):
            for frame in range(opened.frame_count):
                opened.image(camera, frame)
                opened.mask(camera, frame)
    assert "\n" not in str(caught.value)
    problems = check_capture(capture, deep=True).problems
    assert capfd.readouterr().err == "", "a library wrote to stderr"
    assert any(re.search(message, problem) for problem in problems), problems
    assert not any("\n" in problem for problem in problems)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"views": ["01", "0X"]}, r"--views: expected camera names among 00, .*got '0X'; did you mean '0"),
        ({"frames": "2:9"}, r"--frames: expected A:B with 0 <= A < B <= 3, since the capture has 3 frames, got '2:9'"),
        ({"frames": "a"}, r"--frames: expected A:B"),
        ({"frames": "2:2"}, r"--frames: "),
        ({"scale": 0.0}, r"--scale: expected a factor above 0"),
    ],
)
def test_invalid_selections_are_refused(ball_capture: Path, arguments: dict[str, object], message: str) -> None:
    """Catches a selection of views or frames that is empty or silently clipped."""
    with pytest.raises(UserError, match=message):
        open_capture(ball_capture, **arguments)  # type: ignore[arg-type]


def test_check_reports_all_errors(capture: Path) -> None:
    """Catches a check of a capture that stops at the first error."""
    (capture / "images" / "02" / "000001.png").unlink()
    _truncate_png(capture)
    _small_mask(capture)
    report = check_capture(capture, deep=True)
    assert len(report.problems) == 3
    assert report.frames == 3
    assert report.has_masks


def test_check_continues_after_an_invalid_calibration(capture: Path) -> None:
    """Catches a check that reports only the first invalid camera, and a check that skips the images."""
    text = (capture / "extri.yml").read_text()
    for name in ("02", "05"):
        text = re.sub(rf"(T_{name}:.*?data: \[)[^,]*", r"\1.Nan", text, flags=re.DOTALL)
    (capture / "extri.yml").write_text(text)
    (capture / "images" / "03" / "000001.png").unlink()
    problems = check_capture(capture).problems
    assert sum("T_02" in problem for problem in problems) == 1
    assert sum("T_05" in problem for problem in problems) == 1
    assert any("000001" in problem for problem in problems)


def test_parallel_cameras_have_no_focus(capture: Path) -> None:
    """Catches a focus that is computed for parallel cameras, whose optical axes meet only at infinity."""
    cameras = list(open_capture(capture).cameras)
    assert find_focus(cameras) is not None
    same = [replace(camera, rotation=cameras[0].rotation) for camera in cameras]
    assert find_focus(same) is None


def test_check_warns_of_inverted_mattes(capture: Path) -> None:
    """Catches inverted mattes that are not reported. Carving finds no object in inverted mattes."""
    for path in (capture / "masks").glob("*/*.png"):
        matte = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert matte is not None
        cv2.imwrite(str(path), 255 - matte)
    warnings = check_capture(capture).warnings
    assert any("inverted" in warning for warning in warnings)


def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="expected a capture's folder, got no such folder"):
        open_capture(tmp_path / "none")
    with pytest.raises(UserError, match=r"intri.yml: expected the cameras' calibration, got no such file"):
        open_capture(tmp_path)
