"""Import of images: which images of different cameras belong to one moment, and sizes and orientations of the files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.progress import untracked
from fourd.recording.capture import open_capture, write_calibration
from fourd.recording.importing.detection import pick_format
from fourd.recording.importing.importer import ImportOptions, import_source
from tests.captures import ring_cameras

SIZE = 32


def write_source(folder: Path, names: dict[str, list[str]], suffix: str = ".png") -> Path:
    """A calibrated source. The brightness of an image is the number of its frame, times 10."""
    for camera, stems in names.items():
        (folder / "images" / camera).mkdir(parents=True)
        for stem in stems:
            number = int("".join(char for char in stem.split("_")[-1] if char.isdigit()) or 0)
            picture = np.full((SIZE, SIZE, 3), 10 * number % 256, np.uint8)
            assert cv2.imwrite(str(folder / "images" / camera / f"{stem}{suffix}"), picture)
    write_calibration(folder, list(names), ring_cameras(len(names), SIZE))
    return folder


def run_import(source: Path, out: Path, **options: object) -> tuple[list[str], list[str]]:
    """Import a source. Returns its notes and its warnings."""
    notes, warnings = [], []
    import_source(
        pick_format(None, source),
        source,
        out,
        ImportOptions(**options),  # type: ignore[arg-type]
        log=notes.append,
        warn=warnings.append,
        track=untracked,
    )
    return notes, warnings


def brightness(out: Path) -> dict[str, list[int]]:
    """The brightness of the images of all cameras, for each frame."""
    with open_capture(out) as capture:
        return {
            name: [int(capture.image(camera, frame)[0, 0, 0]) for camera in range(len(capture.names))]
            for frame, name in enumerate(capture.frame_names)
        }


def test_lost_images_are_left_out_in_all_cameras(tmp_path: Path) -> None:
    """Catches cameras that lost different frames and are paired by position."""
    numbers = range(10)
    names = {"cam1": [f"{n:06d}" for n in numbers if n != 3], "cam2": [f"{n:06d}" for n in numbers if n != 7]}
    _, warnings = run_import(write_source(tmp_path / "in", names), tmp_path / "out")
    assert warnings == [
        "images are missing: frame 3 in cam1, frame 7 in cam2; 8 of 10 frames are imported, those that all cameras have"
    ]
    found = brightness(tmp_path / "out")
    assert found == {f"{n:06d}": [10 * n, 10 * n] for n in numbers if n not in (3, 7)}
    repeated = run_import(tmp_path / "in", tmp_path / "out")
    assert warnings == repeated[1]


def test_names_without_leading_zeros_and_with_camera_names(tmp_path: Path) -> None:
    """Catches the alphabetical order 1, 10, 2, and names with the camera in front that match nothing."""
    names = {"cam1": [f"cam1_frame_{n}" for n in range(1, 13)], "cam2": [f"cam2_{n:05d}" for n in range(1, 13)]}
    warnings = run_import(write_source(tmp_path / "in", names), tmp_path / "out")[1]
    assert not warnings
    assert brightness(tmp_path / "out") == {f"{n:06d}": [10 * n, 10 * n] for n in range(1, 13)}


SHIFTED = {"cam1": [f"{n:04d}" for n in range(10)], "cam2": [f"{n:04d}" for n in range(100, 110)]}
BY_ONE = {
    "cam1": [f"{n}" for n in range(10)],
    "cam2": [f"{n}" for n in range(1, 11)],
    "cam3": [f"{n}" for n in range(10)],
}


@pytest.mark.parametrize(("names", "span"), [(SHIFTED, "100 to 109"), (BY_ONE, "1 to 10")])
def test_other_first_numbers_are_refused(tmp_path: Path, names: dict[str, list[str]], span: str) -> None:
    """Catches cameras with other first numbers, which may have started later or only count from another number."""
    source = write_source(tmp_path / "in", names)
    message = rf"camera 'cam2': expected the frame numbers of camera 'cam1' \(0 to 9\), got {span}"
    with pytest.raises(UserError, match=message):
        run_import(source, tmp_path / "out")
    run_import(source, tmp_path / "ordered", pair_by="order")
    first = [int(of[0]) % 1000 for of in names.values()]
    assert brightness(tmp_path / "ordered")["000000"] == [10 * number % 256 for number in first]


def test_equal_numbers_can_be_demanded(tmp_path: Path) -> None:
    _, warnings = run_import(write_source(tmp_path / "in", BY_ONE), tmp_path / "out", pair_by="name")
    assert brightness(tmp_path / "out") == {f"{n:06d}": [10 * n] * 3 for n in range(1, 10)}
    assert "frame 10 in cam1, frame 0 in cam2, frame 10 in cam3; 9 of 11 frames" in warnings[0]


def test_few_common_frames_are_refused(tmp_path: Path) -> None:
    """Catches a camera that was copied in part, which would cut all cameras to its frames."""
    names = {"cam1": [f"{n:04d}" for n in range(10)], "cam2": ["0000", "0001"]}
    message = r"camera 'cam2': .* got none for 0002 and for 7 other frames, so only 2 of 10 frames"
    with pytest.raises(UserError, match=message):
        run_import(write_source(tmp_path / "in", names), tmp_path / "out")


def test_time_stamps_that_differ_are_refused(tmp_path: Path) -> None:
    """Catches images paired by position because no name is equal."""
    names = {"cam1": ["t_0.033", "t_0.067"], "cam2": ["t_0.034", "t_0.066"]}
    with pytest.raises(UserError, match=r"only 0 of 4 frames have images of all cameras; .* --pair-by order"):
        run_import(write_source(tmp_path / "in", names), tmp_path / "out")


@pytest.mark.parametrize(
    ("names", "note"),
    [
        ({"left": ["left"], "right": ["right"]}, "one moment"),
        ({"1": ["view_1"], "2": ["view_2"]}, "one moment"),
        ({"cam1": ["000004"], "cam2": ["000004"]}, ""),
    ],
)
def test_one_image_per_camera_is_one_moment(tmp_path: Path, names: dict[str, list[str]], note: str) -> None:
    notes, warnings = run_import(write_source(tmp_path / "in", names), tmp_path / "out")
    assert len(brightness(tmp_path / "out")) == 1
    assert any("taken as one moment" in line for line in (*notes, *warnings)) == bool(note)


def test_single_images_with_other_frame_numbers_are_refused(tmp_path: Path) -> None:
    """Catches two moments that count as one because each camera has one image."""
    with pytest.raises(
        UserError, match=r"camera 'cam2': expected the frame numbers of camera 'cam1' \(4 to 4\), got 9"
    ):
        run_import(write_source(tmp_path / "in", {"cam1": ["f_4"], "cam2": ["f_9"]}), tmp_path / "out")


def test_sizes_that_change_are_refused(tmp_path: Path) -> None:
    """Catches a ValueError from the calibration check, and an error after all images are linked."""
    source = write_source(tmp_path / "in", {"cam1": ["0", "1", "2"], "cam2": ["0", "1", "2"]})
    assert cv2.imwrite(str(source / "images" / "cam2" / "1.png"), np.zeros((SIZE - 8, SIZE, 3), np.uint8))
    message = r"cam2/1.png: expected 32 x 32 pixels like 0.png, the first image of camera 'cam2', got 32 x 24; export"
    with pytest.raises(UserError, match=message):
        run_import(source, tmp_path / "out")
    assert not (tmp_path / "out" / "images").exists()


def test_masks_of_another_size_are_refused(tmp_path: Path) -> None:
    """Catches masks of another size that come to light in the last stage."""
    source = write_source(tmp_path / "in", {"cam1": ["0"], "cam2": ["0"]})
    for name in ("cam1", "cam2"):
        (source / "masks" / name).mkdir(parents=True)
        assert cv2.imwrite(str(source / "masks" / name / "0.png"), np.full((2 * SIZE, 2 * SIZE), 255, np.uint8))
    with pytest.raises(UserError, match=r"masks/cam1/0.png: expected 32 x 32 pixels like the images of camera 'cam1'"):
        run_import(source, tmp_path / "out")


def lens(width: int, height: int, centre: tuple[float, float]) -> Camera:
    intrinsics = np.array([[30.0, 0, centre[0]], [0, 30, centre[1]], [0, 0, 1]])
    return Camera(intrinsics, np.eye(3), np.array([0.0, 0, 3]), width, height)


def write_turned(folder: Path, camera: Camera, orientation: int, with_size: bool) -> Path:
    """Images of 48 x 32 stored pixels."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    for name in ("a", "b"):
        (folder / "images" / name).mkdir(parents=True)
        picture = Image.fromarray(np.full((32, 48, 3), 90, np.uint8))
        picture.save(folder / "images" / name / "000000.jpg", exif=exif)
    write_calibration(folder, ["a", "b"], [camera, camera])
    if not with_size:
        path = folder / "intri.yml"
        path.write_text("".join(line for line in path.read_text().splitlines(True) if line[:2] not in ("W_", "H_")))
    return folder


@pytest.mark.parametrize("with_size", [True, False])
@pytest.mark.parametrize(("orientation", "centre"), [(6, (32 - 17.0, 23.0)), (8, (17.0, 48 - 23.0))])
def test_calibrations_of_stored_images_are_turned(
    tmp_path: Path, orientation: int, centre: tuple[float, float], with_size: bool
) -> None:
    """Catches images that are turned without their calibration, and a turn to the wrong side."""
    source = write_turned(tmp_path / "in", lens(48, 32, (23.0, 17.0)), orientation, with_size)
    notes, _ = run_import(source, tmp_path / "out")
    assert any(
        f"EXIF orientation {orientation}); the calibration of the stored images is turned too" in n for n in notes
    )
    with open_capture(tmp_path / "out") as capture:
        camera = capture.cameras[0]
        assert (camera.width, camera.height) == (32, 48)
        assert np.allclose(camera.intrinsics[:2, 2], centre)
        assert capture.image(0, 0).shape == (48, 32, 3)


@pytest.mark.parametrize("with_size", [True, False])
def test_calibrations_of_upright_images_are_kept(tmp_path: Path, with_size: bool) -> None:
    source = write_turned(tmp_path / "in", lens(32, 48, (15.0, 23.0)), 6, with_size)
    notes, _ = run_import(source, tmp_path / "out")
    assert any("the calibration belongs to the upright images" in note for note in notes)
    with open_capture(tmp_path / "out") as capture:
        assert np.allclose(capture.cameras[0].intrinsics[:2, 2], (15.0, 23.0))


def test_mirrored_images_with_a_calibration_of_the_stored_images_are_refused(tmp_path: Path) -> None:
    source = write_turned(tmp_path / "in", lens(48, 32, (23.0, 17.0)), 5, with_size=True)
    with pytest.raises(UserError, match="since EXIF orientation 5 mirrors the images, got one of the stored images"):
        run_import(source, tmp_path / "out")


@pytest.mark.parametrize("suffix", [".bmp", ".tif", ".webp"])
def test_other_formats_are_imported(tmp_path: Path, suffix: str) -> None:
    """Catches BMP images of machine vision cameras that are not found."""
    run_import(write_source(tmp_path / "in", {"cam1": ["0", "1"], "cam2": ["0", "1"]}, suffix), tmp_path / "out")
    assert list(brightness(tmp_path / "out")) == ["000000", "000001"]


def test_unknown_formats_are_named(tmp_path: Path) -> None:
    """Catches "got none" beside a folder full of images."""
    source = write_source(tmp_path / "in", {"cam1": ["0"], "cam2": ["0"]})
    (source / "images" / "cam1" / "0.png").rename(source / "images" / "cam1" / "0.exr")
    with pytest.raises(UserError, match=r"images/cam1: expected images \(.*\), got only .exr files; convert them"):
        open_capture(source)


def test_a_damaged_mask_does_not_stop_the_import(tmp_path: Path) -> None:
    """Catches an import that fails after everything is written, because one mask of thousands is damaged."""
    source = write_source(tmp_path / "in", {"cam1": ["0"], "cam2": ["0"]})
    for name in ("cam1", "cam2"):
        (source / "masks" / name).mkdir(parents=True)
        assert cv2.imwrite(str(source / "masks" / name / "0.png"), np.full((SIZE, SIZE), 255, np.uint8))
    whole = (source / "masks" / "cam2" / "0.png").read_bytes()
    (source / "masks" / "cam2" / "0.png").write_bytes(whole[:-20])
    _, warnings = run_import(source, tmp_path / "out")
    assert any("masks/cam2/000000.png: expected a complete" in line for line in warnings)
    assert len(brightness(tmp_path / "out")) == 1
