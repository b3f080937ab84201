"""Images of every kind that the reader takes, and alpha channels and EXIF orientations of captures opened in place."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageFile, TiffImagePlugin, WebPImagePlugin

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.pipeline.facts import has_masks
from fourd.recording.capture import open_capture, write_calibration
from fourd.recording.capture.check import check_capture
from fourd.recording.capture.decoding import decode_rgb, picture_size, read_header
from fourd.recording.capture.pictures.bits import check_bits
from tests.captures import ring_cameras, write_ball_capture

WIDTH, HEIGHT = 24, 16


@pytest.fixture
def rgb() -> np.ndarray:
    small = np.random.default_rng(0).integers(0, 255, (4, 6, 3), np.uint8)
    return np.asarray(cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif", ".TIFF", ".webp", ".jpg", ".JPG"])
def test_formats(tmp_path: Path, rgb: np.ndarray, suffix: str) -> None:
    """Catches a format that a list of suffixes has and the decoder refuses."""
    path = tmp_path / f"a{suffix}"
    Image.fromarray(rgb).save(path, **({"lossless": True} if suffix == ".webp" else {"quality": 98, "subsampling": 0}))
    assert picture_size(path) == (WIDTH, HEIGHT)
    assert np.abs(decode_rgb(path).astype(int) - rgb).mean() < (4 if suffix.lower() == ".jpg" else 1e-9)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_values_of_16_bits_are_scaled(tmp_path: Path, rgb: np.ndarray, suffix: str) -> None:
    """Catches 16-bit values that are clipped instead of scaled."""
    for name, values in (("rgb", rgb), ("grey", rgb[..., 0])):
        path = tmp_path / f"{name}{suffix}"
        assert cv2.imwrite(str(path), values[..., ::-1].astype(np.uint16) * 257)
        expected = rgb if name == "rgb" else np.repeat(rgb[:, ::-1, :1], 3, axis=2)
        assert np.array_equal(decode_rgb(path), expected)


@pytest.mark.parametrize("is_grey", [False, True])
def test_12_of_16_bits_are_refused(tmp_path: Path, rgb: np.ndarray, is_grey: bool) -> None:
    """Catches recordings of 12-bit cameras that become almost black."""
    values = rgb[..., 0] if is_grey else rgb
    for name, factor in (("dark.png", 16), ("bright.png", 257)):
        assert cv2.imwrite(str(tmp_path / name), values.astype(np.uint16) * factor)
    check_bits([tmp_path / "dark.png", tmp_path / "bright.png"])
    with pytest.raises(
        UserError, match=r"dark.png: expected values of 16 bits up to 65535, got at most about [0-9]+ in"
    ):
        check_bits([tmp_path / "dark.png"])


def test_cmyk_and_grey_jpegs(tmp_path: Path, rgb: np.ndarray) -> None:
    """Catches CMYK values that are read as inverted."""
    Image.fromarray(rgb).convert("CMYK").save(tmp_path / "cmyk.jpg", quality=98)
    Image.fromarray(rgb).convert("L").save(tmp_path / "grey.jpg", quality=98)
    assert np.abs(decode_rgb(tmp_path / "cmyk.jpg").astype(int) - rgb).mean() < 4
    grey = np.asarray(Image.fromarray(rgb).convert("L"))
    assert np.abs(decode_rgb(tmp_path / "grey.jpg").astype(int) - grey[..., None]).mean() < 2


def test_several_pages_and_32_bits_are_refused(tmp_path: Path, rgb: np.ndarray) -> None:
    """Catches a file with several frames of which only the first is used, and values of unknown range."""
    image = Image.fromarray(rgb)
    image.save(tmp_path / "pages.tif", save_all=True, append_images=[image])
    assert cv2.imwrite(str(tmp_path / "float.tif"), rgb[..., 0].astype(np.float32))
    with pytest.raises(UserError, match=r"pages.tif: .* got '2 pages, expected one image per file'"):
        decode_rgb(tmp_path / "pages.tif")
    with pytest.raises(UserError, match=r"float.tif: expected 8 or 16 bits per value, got 32; export"):
        decode_rgb(tmp_path / "float.tif")


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".webp"])
def test_exif_orientation_turns_images_upright(tmp_path: Path, rgb: np.ndarray, suffix: str, orientation: int) -> None:
    """Catches a size that is not the size of the decoded image, and an orientation that is turned the wrong way."""
    path = tmp_path / f"a{suffix}"
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(rgb).save(path, exif=exif, quality=98)
    decoded = decode_rgb(path)
    assert picture_size(path) == (decoded.shape[1], decoded.shape[0])
    if suffix == ".tif":
        path = path.with_suffix(".png")  # OpenCV 5.0 does not read turned TIFF images.
        Image.fromarray(rgb).save(path, exif=exif)
    expected = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    assert decoded.shape == expected.shape
    assert np.abs(decoded.astype(int) - expected).mean() < 4


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".webp"])
def test_headers_are_read_without_decoding(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a header that costs as much as its image, because Pillow looks for metadata behind the image."""
    path = tmp_path / f"a{suffix}"
    Image.fromarray(np.zeros((HEIGHT, WIDTH, 3), np.uint8)).save(path)

    def fail(*arguments: object) -> None:
        pytest.fail("the image was decoded")

    for kind in (ImageFile.ImageFile, WebPImagePlugin.WebPImageFile, TiffImagePlugin.TiffImageFile):
        monkeypatch.setattr(kind, "load", fail)
    assert read_header(path).size == (WIDTH, HEIGHT)


def write_turned(folder: Path, camera: Camera, orientations: tuple[int, ...] = (6, 6)) -> Path:
    """A capture of two cameras whose images are stored as 24 x 16 pixels."""
    exif = Image.Exif()
    for name in ("a", "b"):
        (folder / "images" / name).mkdir(parents=True)
        for frame, orientation in enumerate(orientations):
            exif[0x0112] = orientation
            picture = Image.fromarray(np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
            picture.save(folder / "images" / name / f"{frame:06d}.jpg", exif=exif)
    write_calibration(folder, ["a", "b"], [camera, camera])
    return folder


def lens(width: int, height: int) -> Camera:
    intrinsics = np.array([[20.0, 0, width / 2], [0, 20, height / 2], [0, 0, 1]])
    return Camera(intrinsics, np.eye(3), np.array([0.0, 0, 3]), width, height)


def test_turned_captures_are_read_in_place(tmp_path: Path) -> None:
    with open_capture(write_turned(tmp_path, lens(HEIGHT, WIDTH))) as capture:
        assert capture.image(0, 0).shape == (WIDTH, HEIGHT, 3)
    assert not check_capture(tmp_path).problems


def test_calibrations_of_stored_images_are_refused_in_place(tmp_path: Path) -> None:
    """Catches an image that is turned although its calibration is not."""
    folder = write_turned(tmp_path, lens(WIDTH, HEIGHT))
    message = r"000000.jpg: expected a calibration of the upright images \(16 x 24\) of camera 'a', since EXIF"
    with pytest.raises(UserError, match=message):
        open_capture(folder)
    assert any("expected a calibration of the upright images" in problem for problem in check_capture(folder).problems)


def test_a_camera_that_turns_is_refused(tmp_path: Path) -> None:
    """Catches one image of a static camera that is turned differently from the others."""
    folder = write_turned(tmp_path, lens(WIDTH, HEIGHT), (1, 3))
    message = r"000001.jpg: expected EXIF orientation 1 as in the camera's first image, got 3"
    with open_capture(folder) as capture, pytest.raises(UserError, match=message):
        capture.image(0, 1)
    assert any("expected EXIF orientation 1" in problem for problem in check_capture(folder).problems)


def make_cutouts(capture: Path) -> None:
    """Replace the images of a capture by cut-outs with hidden magenta, and remove the masks."""
    for path in sorted((capture / "images").glob("*/*.png")):
        mask_path = capture / "masks" / path.parent.name / path.name
        rgba = np.dstack([cv2.imread(str(path)), cv2.imread(str(mask_path), cv2.IMREAD_GRAYSCALE)])
        rgba[rgba[..., 3] == 0, :3] = (255, 0, 255)
        assert cv2.imwrite(str(path), rgba)
        mask_path.unlink()
    for folder in (*(capture / "masks").iterdir(), capture / "masks"):
        folder.rmdir()


def test_alpha_is_the_matte_of_captures_without_masks(tmp_path: Path) -> None:
    """Catches alpha channels that are dropped, and hidden colours that are used."""
    with open_capture(write_ball_capture(tmp_path, cameras=4)) as original:
        masks = [original.mask(camera, 1) for camera in range(4)]
        images = [original.image(camera, 1) for camera in range(4)]
    make_cutouts(tmp_path)
    assert has_masks(tmp_path)
    report = check_capture(tmp_path)
    assert report.has_masks
    assert report.coverage
    assert not report.problems
    assert any("alpha channel" in line for line in report.notes)
    with open_capture(tmp_path) as capture:
        for camera in range(4):
            image, mask = capture.image(camera, 1), capture.mask(camera, 1)
            assert np.array_equal(mask, masks[camera])
            assert np.array_equal(image[mask > 0], images[camera][mask > 0])
            assert not image[mask == 0].any()


def test_hidden_colours_do_not_bleed_into_undistorted_or_scaled_images(tmp_path: Path) -> None:
    """Catches interpolation between the object and the hidden colours beside it."""
    size = 64
    cameras = []
    for camera in ring_cameras(2, size):
        k = camera.intrinsics
        cameras.append(
            Camera(k, camera.rotation, camera.translation, size, size, np.array([-0.2, 0.05, 0.01, 0.0, 0.0]))
        )
    rgba = np.full((size, size, 4), (255, 0, 255, 0), np.uint8)
    rgba[20:44, 20:44] = (40, 200, 40, 255)
    rgba[20:44, 43] = (40, 200, 40, 128)
    for name in ("00", "01"):
        (tmp_path / "images" / name).mkdir(parents=True)
        Image.fromarray(rgba).save(tmp_path / "images" / name / "000000.png")
    write_calibration(tmp_path, ["00", "01"], cameras)
    for scale in (1.0, 0.6):
        with open_capture(tmp_path, scale=scale) as capture:
            image, mask = capture.image(0, 0), capture.mask(0, 0)
            assert np.abs(image[mask > 8].astype(int) - (40, 200, 40)).max() <= 4
            assert not image[mask == 0].any() or np.abs(image[image.any(axis=2)].astype(int)[:, 0] - 40).max() <= 12


def test_opaque_alpha_is_no_matte(tmp_path: Path) -> None:
    """Catches recorded images with an unused alpha channel that count as cut out."""
    write_ball_capture(tmp_path, cameras=3)
    make_cutouts(tmp_path)
    for path in (tmp_path / "images").glob("*/*.png"):
        rgba = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        rgba[..., 3] = 255
        assert cv2.imwrite(str(path), rgba)
    assert not has_masks(tmp_path)
    assert not check_capture(tmp_path).has_masks
    with open_capture(tmp_path) as capture:
        assert not capture.has_masks


def test_images_with_other_names_are_matched_in_place(tmp_path: Path) -> None:
    """Catches a capture that is refused because each camera puts its own name into the names of its images."""
    write_ball_capture(tmp_path, cameras=3, frames=3)
    for path in sorted(tmp_path.glob("*/*/*.png")):
        kind = "mask" if path.parts[-3] == "masks" else "cam"
        path.rename(path.with_name(f"{kind}{path.parent.name}_{int(path.stem) + 8}.png"))
    assert not check_capture(tmp_path).problems
    with open_capture(tmp_path) as capture:
        assert capture.frame_names == ("000008", "000009", "000010")
        assert capture.mask(2, 2).any()
    (tmp_path / "images" / "01" / "cam01_9.png").unlink()
    with pytest.raises(UserError, match=r"images/01/000009.png: expected an image, since other cameras have"):
        open_capture(tmp_path)
