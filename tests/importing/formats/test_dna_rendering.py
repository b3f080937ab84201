"""DNA-Rendering: HDF5 files with the groups, names and types that the data set's own reader uses."""

from __future__ import annotations

from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.recording.importing.formats.dna_rendering import read
from fourd.recording.importing.imported import EncodedPictures
from tests.importing.formats.sources import (
    BARREL,
    assert_damage_is_reported,
    assert_refused,
    assert_same_view,
    detect_format,
    picture_bytes,
    uneven_cameras,
)

FRAMES = 12
IDS = {"0": "Camera_5mp", "2": "Camera_5mp", "48": "Camera_12mp"}


def as_bytes(content: bytes) -> np.ndarray:
    return np.frombuffer(content, np.uint8)


def write_calibration(file: h5py.File) -> None:
    """Write camera-to-world poses. Pixel coordinates have their origin at the centre of the first pixel."""
    for number, camera in zip(IDS, uneven_cameras(3, BARREL), strict=True):
        group = file.create_group(f"Camera_Parameter/{int(number):02d}")
        group["K"] = camera.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
        group["D"] = BARREL
        group["RT"] = np.linalg.inv(np.vstack([np.c_[camera.rotation, camera.translation], [0, 0, 0, 1]]))
        group["Color_Calibration"] = np.eye(3)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    with h5py.File(tmp_path / "0012_11.smc", "w") as file:
        for number, group in IDS.items():
            for frame in range(FRAMES):
                file[f"{group}/{number}/color/{frame}"] = as_bytes(picture_bytes(".jpg", 20 * frame))
    with h5py.File(tmp_path / "0012_11_annots.smc", "w") as file:
        write_calibration(file)
        for number in IDS:
            for frame in range(FRAMES):
                file[f"Mask/{number}/mask/{frame}"] = as_bytes(picture_bytes(".png", 255 - frame))
    return tmp_path


def mean_grey(frames: object, index: int) -> int:
    assert isinstance(frames, EncodedPictures)
    picture = cv2.imdecode(as_bytes(frames.read(index)), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    return round(float(np.mean(picture)))


def test_cameras_project_as_the_originals(source: Path, rng: np.random.Generator) -> None:
    """Catches poses that are read as world-to-camera, and frames in alphabetical order (10 before 2)."""
    assert detect_format(source) == detect_format(source / "0012_11.smc") == "dna-rendering"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == ["00", "02", "48"]
    for camera, original in zip(imported.cameras, uneven_cameras(3, BARREL), strict=True):
        assert_same_view(camera.calibration, original, rng)
        assert isinstance(camera.frames, EncodedPictures)
        assert (camera.frames.count, camera.frames.suffix) == (FRAMES, ".jpg")
        assert [mean_grey(camera.frames, index) for index in (2, 10)] == [40, 200]
        assert isinstance(camera.masks, EncodedPictures)
        assert (camera.masks.count, camera.masks.suffix) == (FRAMES, ".png")
        assert [mean_grey(camera.masks, index) for index in (2, 10)] == [253, 245]


def test_calibration_in_other_places(source: Path, rng: np.random.Generator) -> None:
    """Catches an importer that searches for the calibration in only one of the three places that the data set uses."""
    (source / "main").mkdir()
    (source / "annotations").mkdir()
    for name, folder in (("0012_11.smc", "main"), ("0012_11_annots.smc", "annotations")):
        (source / name).rename(source / folder / name)
    imported = read(source / "main")
    assert imported.cameras[0].masks is not None
    (source / "annotations" / "0012_11_annots.smc").unlink()
    with h5py.File(source / "main" / "0012_11.smc", "a") as file:
        write_calibration(file)
    imported = read(source / "main" / "0012_11.smc")
    assert imported.cameras[0].masks is None
    assert_same_view(imported.cameras[2].calibration, uneven_cameras(3, BARREL)[2], rng)


def _replace(name: str, value: object) -> object:
    def damage(main: h5py.File, annotations: h5py.File) -> None:
        file = annotations if name.startswith(("Camera_P", "Mask")) else main
        del file[name]
        if value is not None:
            file[name] = value

    return damage


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_replace("Camera_Parameter", None), r"_annots.smc: expected the group Camera_Parameter, got none; download"),
        (_replace("Camera_Parameter/02/RT", None), r"_annots.smc: expected Camera_Parameter/02/RT, got none"),
        (
            _replace("Camera_Parameter/02/RT", np.diag([1.0, 1.0, -1.0, 1.0])),
            r"Camera_Parameter/02: rotation: .* got a reflection",
        ),
        (_replace("Camera_Parameter/02/RT", 9 * np.eye(4)), r"Camera_Parameter/02: rotation: expected an orthonormal"),
        (_replace("Camera_Parameter/02/K", np.full((3, 3), np.nan)), r"Camera_Parameter/02/K: expected finite numbers"),
        (_replace("Camera_Parameter/02/K", np.eye(4)), r"Camera_Parameter/02/K: expected 3 x 3 numbers, got 4 x 4"),
        (
            _replace("Camera_Parameter/02/D", "none"),
            r"Camera_Parameter/02/D: expected a matrix of numbers, got object",
        ),
        (_replace("Camera_5mp/2/color", None), r"0012_11.smc: expected the group Camera_5mp/2/color, got none"),
        (
            _replace("Camera_5mp/2/color/0", "text"),
            r"Camera_5mp/2/color/0: expected the bytes of an image, got object",
        ),
        (_replace("Camera_5mp/2/color/0", as_bytes(b"GIF")), r"Camera_5mp/2/color/0: expected a JPEG or PNG, got some"),
        (_replace("Mask/2/mask/5", None), r"_annots.smc: Mask/2: expected 12 mattes, one for each image, got 11"),
    ],
)
def test_invalid_values_are_reported(source: Path, damage: object, message: str) -> None:
    assert callable(damage)
    with h5py.File(source / "0012_11.smc", "a") as main, h5py.File(source / "0012_11_annots.smc", "a") as annotations:
        damage(main, annotations)
    assert_refused(read, source, message)


def test_missing_and_other_files_are_reported(source: Path) -> None:
    (source / "0012_11_annots.smc").rename(source / "kept")
    assert_refused(
        read, source, r"expected the group Camera_Parameter in this file or in 0012_11_annots.smc, got neither"
    )
    (source / "0013_01.smc").write_text("text")
    assert_refused(read, source, r"expected one NAME.smc, got 0012_11.smc and 0013_01.smc; name the file itself")
    assert_refused(read, source / "0013_01.smc", r"0013_01.smc: expected HDF5, got '.*'; download it again")
    with h5py.File(source / "0013_01.smc", "w") as file:
        file["Kinect"] = 1
    assert_refused(read, source / "0013_01.smc", r"expected the group Camera_5mp or Camera_12mp, got neither; download")


def _external_storage(file: h5py.File, name: str, secret: Path) -> None:
    file.create_dataset(name, (6,), np.uint8, external=[(str(secret), 0, 6)])


def _external_link(file: h5py.File, name: str, secret: Path) -> None:
    file[name] = h5py.ExternalLink(str(secret.with_suffix(".h5")), "/secret")


def _soft_link_to_external_link(file: h5py.File, name: str, secret: Path) -> None:
    file["outside"] = h5py.ExternalLink(str(secret.with_suffix(".h5")), "/")
    file[name] = h5py.SoftLink("/outside/secret")


def _virtual_dataset(file: h5py.File, name: str, secret: Path) -> None:
    layout = h5py.VirtualLayout((6,), np.uint8)
    layout[:] = h5py.VirtualSource(str(secret.with_suffix(".h5")), "secret", (6,), np.uint8)
    file.create_virtual_dataset(name, layout)


@pytest.mark.parametrize(
    ("store", "got"),
    [
        (_external_storage, "external storage"),
        (_external_link, "a link to .*secret.h5"),
        (_soft_link_to_external_link, "a link to .*secret.h5"),
        (_virtual_dataset, "a virtual dataset"),
    ],
)
@pytest.mark.parametrize("name", ["Camera_5mp/2/color/0", "Camera_5mp/2/color/3"])
def test_data_of_other_files_are_refused(source: Path, store: object, got: str, name: str) -> None:
    """Catches a downloaded file whose import copies the user's own files into the capture."""
    assert callable(store)
    secret = source / "secret.txt"
    secret.write_text("secret")
    with h5py.File(source / "secret.h5", "w") as file:
        file["secret"] = as_bytes(b"secret")
    with h5py.File(source / "0012_11.smc", "a") as file:
        del file[name]
        store(file, name, secret)
    message = rf"{name}: expected data within this file, got {got}; download it again"
    with pytest.raises(UserError, match=message):
        for camera in read(source).cameras:
            assert isinstance(camera.frames, EncodedPictures)
            for index in range(FRAMES):
                camera.frames.read(index)


def test_soft_links_within_the_file_are_followed(source: Path) -> None:
    """Catches a link to another frame's image that is not followed, and a link to itself that is followed forever."""
    with h5py.File(source / "0012_11.smc", "a") as file:
        for frame, target in ((3, "2"), (4, "/Camera_5mp/2/color/2"), (5, "5")):
            del file[f"Camera_5mp/2/color/{frame}"]
            file[f"Camera_5mp/2/color/{frame}"] = h5py.SoftLink(target)
    frames = read(source).cameras[1].frames
    assert [mean_grey(frames, index) for index in (3, 4)] == [40, 40]
    with pytest.raises(UserError, match=r"expected Camera_5mp/2/color/5, got none"):
        mean_grey(frames, 5)


def test_damaged_files_are_reported(source: Path, rng: np.random.Generator) -> None:
    assert_damage_is_reported(read, source, source / "0012_11_annots.smc", rng)
