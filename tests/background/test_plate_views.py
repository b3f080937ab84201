"""Reading of clean plates that the user provides or that fourd makes."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.reconstruction.background.plates import read_plates
from fourd.recording.capture import Capture, open_capture, read_calibration, write_calibration
from fourd.recording.matting.plates import FOLDER, Plate, write_plate

SIZE = 64
LENS = np.array([-0.25, 0.08, 0.002, -0.001])


@pytest.fixture
def folder(ball_capture: Path, tmp_path: Path) -> Path:
    """A writable copy of a capture without plates."""
    return Path(shutil.copytree(ball_capture, tmp_path / "cap"))


def stage(rng: np.random.Generator) -> np.ndarray:
    """A smooth image (H, W, 3), which resampling hardly changes."""
    return cv2.GaussianBlur(rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8), (0, 0), 4)


def make_plate(folder: Path, name: str, rgb: np.ndarray, seen: np.ndarray | None = None) -> None:
    """Write a plate in the format of fourd.recording.matting."""
    write_plate(folder / FOLDER / f"{name}.png", Plate(rgb, np.ones(rgb.shape[:2], bool) if seen is None else seen))


def provide(folder: Path, name: str, picture: np.ndarray) -> Path:
    """Write a plate in RGB or RGBA into the folder for plates that the user provides."""
    path = folder / "bgs" / name
    path.parent.mkdir(exist_ok=True)
    code = cv2.COLOR_RGBA2BGRA if picture.shape[2] == 4 else cv2.COLOR_RGB2BGR
    assert cv2.imwrite(str(path), cv2.cvtColor(picture, code))
    return path


def distort(folder: Path) -> Capture:
    """Give all cameras of a capture lens distortion."""
    calibrations = read_calibration(folder)
    cameras = [replace(one.camera(SIZE, SIZE), distortion=LENS) for one in calibrations.values()]
    write_calibration(folder, list(calibrations), cameras)
    return open_capture(folder)


def test_made_plates(folder: Path, rng: np.random.Generator) -> None:
    """Catches swapped channels, plates assigned to the wrong camera, and lost holes."""
    pictures, hole = [stage(rng) for _ in range(3)], np.zeros((SIZE, SIZE), bool)
    hole[10:20, 30:40] = True
    for name, picture in zip(("02", "00", "05"), pictures, strict=True):
        make_plate(folder, name, picture, ~hole)
    capture = open_capture(folder)
    views = read_plates(capture, [2, 0, 5])
    assert [view.name for view in views] == ["02", "00", "05"]
    for view, picture, index in zip(views, pictures, (2, 0, 5), strict=True):
        assert view.camera is capture.cameras[index]
        assert np.array_equal(view.rgb, picture)
        assert np.array_equal(view.seen, ~hole)


def test_the_users_plates_come_first(folder: Path, rng: np.random.Generator) -> None:
    """Catches a user's plate that is ignored because fourd also made a plate, and JPEG plates that are not found."""
    made, provided = stage(rng), stage(rng)
    for name in ("00", "01", "02"):
        make_plate(folder, name, made)
    provide(folder, "00.png", provided)
    provide(folder, "01.jpg", provided)
    views = read_plates(open_capture(folder), [0, 1, 2])
    assert np.array_equal(views[0].rgb, provided)
    assert np.abs(views[1].rgb.astype(int) - provided).mean() < 4
    assert np.array_equal(views[2].rgb, made)
    assert all(view.seen.all() for view in views)


def test_the_users_holes(folder: Path, rng: np.random.Generator) -> None:
    """Catches an alpha channel that is ignored, and semi-transparent pixels that count as visible."""
    picture, alpha = stage(rng), np.full((SIZE, SIZE), 255, np.uint8)
    alpha[:8], alpha[8:12] = 0, 128
    for name in ("00.png", "01.png"):
        provide(folder, name, np.dstack([picture, alpha]))
    for view in read_plates(open_capture(folder), [0, 1]):
        assert np.array_equal(view.seen, alpha == 255)
        assert np.array_equal(view.rgb, picture)


def test_scale(folder: Path, rng: np.random.Generator) -> None:
    """Catches plates that are not resized to the cameras, and pixels partly in a hole that count as visible."""
    picture, seen = stage(rng), np.ones((SIZE, SIZE), bool)
    seen[:, 31:] = False
    for name in ("00", "01"):
        make_plate(folder, name, np.where(seen[..., None], picture, 255).astype(np.uint8), seen)
    capture = open_capture(folder, scale=0.5)
    for index, view in enumerate(read_plates(capture, [0, 1])):
        assert view.camera is capture.cameras[index]
        assert view.rgb.shape == (32, 32, 3)
        assert view.seen[:, :15].all()
        assert not view.seen[:, 15:].any(), "half of column 15 is a hole"
        small = cv2.resize(picture, (32, 32), interpolation=cv2.INTER_AREA)
        assert np.abs(view.rgb.astype(int) - small)[view.seen].max() <= 1


def test_the_users_plates_are_undistorted_like_the_pictures(folder: Path, rng: np.random.Generator) -> None:
    """Catches plates that are not undistorted like the frames, so that points miss the walls."""
    picture = stage(rng)
    for name in ("00", "01"):
        provide(folder, f"{name}.png", picture)
        assert cv2.imwrite(str(folder / "images" / name / "000000.png"), picture[..., ::-1])
    capture = distort(folder)
    for index, view in enumerate(read_plates(capture, [0, 1])):
        assert np.array_equal(view.rgb, capture.image(index, 0))
        assert np.abs(view.rgb.astype(int) - picture).max() > 5, "the distortion has an effect"


def test_made_plates_are_not_undistorted_again(folder: Path, rng: np.random.Generator) -> None:
    """Catches plates that are undistorted twice, and pixels outside the lens's field of view that count as a black
    wall."""
    picture = stage(rng)
    for name in ("00", "01"):
        make_plate(folder, name, picture)
    calibrations = read_calibration(folder)
    wide = [replace(one.camera(SIZE, SIZE), distortion=-2 * LENS) for one in calibrations.values()]
    write_calibration(folder, list(calibrations), wide)
    for view in read_plates(open_capture(folder), [0, 1]):
        assert np.array_equal(view.rgb, picture)
        assert view.seen[20:44, 20:44].all()
        assert not view.seen[0, 0]


def test_plates_of_mostly_holes_are_reported(folder: Path, rng: np.random.Generator) -> None:
    """Catches a plate with large holes that is not reported, and a good plate that is reported."""
    hole = np.ones((SIZE, SIZE), bool)
    hole[:20] = False
    for name in ("00", "01", "02"):
        make_plate(folder, name, stage(rng), ~hole if name == "01" else None)
    lines: list[str] = []
    read_plates(open_capture(folder), [0, 1, 2], lines.append)
    assert len(lines) == 1
    assert "clean plate of 01 is a hole" in lines[0]


@pytest.mark.parametrize("seeing", [0, 1])
def test_too_few_plates_with_background(folder: Path, seeing: int, rng: np.random.Generator) -> None:
    """Catches triangulation from fewer than two images."""
    for number, name in enumerate(("00", "01")):
        make_plate(folder, name, stage(rng), np.full((SIZE, SIZE), number < seeing))
    with pytest.raises(
        UserError, match=rf"cap: expected clean plates of at least 2 cameras .*, got {seeing}; "
    ) as caught:
        read_plates(open_capture(folder), [0, 1])
    assert "\n" not in str(caught.value)


def test_missing_plate(folder: Path, rng: np.random.Generator) -> None:
    """Catches an error that does not name the missing plates and the command that makes them."""
    make_plate(folder, "00", stage(rng))
    with pytest.raises(
        UserError,
        match=r"plates/01\.png: expected the clean plate of camera '01' \(and of 1 more camera\), "
        r"got no such file here or in bgs; make clean plates: fourd matte .*cap",
    ):
        read_plates(open_capture(folder), [0, 1, 2])


def test_wrong_size(folder: Path, rng: np.random.Generator) -> None:
    """Catches a plate of the wrong size that is silently resized. Also catches advice that confuses plates from the
    user with plates made by fourd."""
    for name in ("00", "01"):
        make_plate(folder, name, stage(rng))
    provide(folder, "01.png", stage(rng)[:32])
    with pytest.raises(
        UserError, match=r"bgs/01\.png: expected 64 x 64 pixels like .*'01', got 64 x 32; export the plate again"
    ):
        read_plates(open_capture(folder), [0, 1])
    make_plate(folder, "00", stage(rng)[:, :48])
    with pytest.raises(UserError, match=r"plates/00\.png: expected 64 x 64 .*, got 48 x 64; remove this plate"):
        read_plates(open_capture(folder), [0, 1])


@pytest.mark.parametrize("content", [b"", b"no picture", b"\x89PNG\r\n\x1a\n"])
def test_broken_file(folder: Path, content: bytes, rng: np.random.Generator) -> None:
    """Catches a traceback for a file that is not an image."""
    make_plate(folder, "01", stage(rng))
    provide(folder, "00.png", stage(rng)).write_bytes(content)
    with pytest.raises(UserError, match=r"bgs/00\.png: expected a complete JPEG, PNG, .* image, got ") as caught:
        read_plates(open_capture(folder), [0, 1])
    assert "\n" not in str(caught.value)


def test_truncated_plates_are_errors(folder: Path, rng: np.random.Generator) -> None:
    """Catches a truncated image that is accepted as a plate."""
    make_plate(folder, "01", stage(rng))
    path = provide(folder, "00.png", stage(rng))
    whole = path.read_bytes()
    capture = open_capture(folder)
    for length in range(0, len(whole) - 20, max(1, len(whole) // 12)):
        path.write_bytes(whole[:length])
        with pytest.raises(UserError, match=r"bgs/00\.png: "):
            read_plates(capture, [0, 1])
