"""COLMAP: handwritten text and binary models of cameras, where each camera has its own folder of images."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fourd.cameras import Camera
from fourd.importing.formats.colmap import read
from tests.importing.formats.sources import (
    HEIGHT,
    WIDTH,
    assert_damage_is_reported,
    assert_refused,
    assert_same_view,
    detect_format,
    edit,
    file_names,
    uneven_cameras,
    write_pictures,
    write_video,
)

FX, FY, CX, CY = 31.0, 29.0, 11.3, 8.9
K1, K2, P1, P2 = -0.2, 0.05, 0.002, -0.001
MODELS: dict[str, tuple[int, list[float], list[float]]] = {
    "SIMPLE_PINHOLE": (0, [FX, CX, CY], []),
    "PINHOLE": (1, [FX, FY, CX, CY], []),
    "SIMPLE_RADIAL": (2, [FX, CX, CY, K1], [K1, 0, 0, 0]),
    "RADIAL": (3, [FX, CX, CY, K1, K2], [K1, K2, 0, 0]),
    "OPENCV": (4, [FX, FY, CX, CY, K1, K2, P1, P2], [K1, K2, P1, P2]),
    "FULL_OPENCV": (
        6,
        [FX, FY, CX, CY, K1, K2, P1, P2, 0.01, 0.02, 0.03, 0.04],
        [K1, K2, P1, P2, 0.01, 0.02, 0.03, 0.04],
    ),
}
"""For each lens model, COLMAP's number, the parameters in COLMAP's order, and OpenCV's distortion coefficients."""


def expected_camera(camera: Camera, kind: str) -> Camera:
    """The camera with the intrinsics and the distortion of a lens model."""
    focal_y = FY if len(MODELS[kind][1]) not in (3, 5) and kind != "SIMPLE_RADIAL" else FX
    intrinsics = np.array([[FX, 0, CX], [0, focal_y, CY], [0, 0, 1]])
    distortion = np.array(MODELS[kind][2]) if MODELS[kind][2] else None
    return replace(camera, intrinsics=intrinsics, distortion=distortion)


def colmap_pose(camera: Camera) -> list[float]:
    """Quaternion and translation of a camera, in COLMAP's order."""
    x, y, z, w = Rotation.from_matrix(camera.rotation).as_quat()
    return [float(value) for value in (w, x, y, z, *camera.translation)]


def write_text(folder: Path, images: list[tuple[str, Camera]], kind: str = "OPENCV") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    parameters = " ".join(map(repr, MODELS[kind][1]))
    (folder / "cameras.txt").write_text(f"# cameras\n1 {kind} {WIDTH} {HEIGHT} {parameters}\n")
    lines = [
        f"{number} {' '.join(map(repr, colmap_pose(camera)))} 1 {name}\n\n"
        for number, (name, camera) in enumerate(images, 1)
    ]
    (folder / "images.txt").write_text("# images\n" + "".join(lines))
    (folder / "points3D.txt").write_text("")


def write_binary(folder: Path, images: list[tuple[str, Camera]], kind: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    number, parameters, _ = MODELS[kind]
    cameras = struct.pack("<QIiQQ", 1, 1, number, WIDTH, HEIGHT) + struct.pack(f"<{len(parameters)}d", *parameters)
    (folder / "cameras.bin").write_bytes(cameras)
    content = struct.pack("<Q", len(images))
    for index, (name, camera) in enumerate(images, 1):
        content += struct.pack("<I7dI", index, *colmap_pose(camera), 1) + name.encode() + b"\0"
        content += struct.pack("<Q", 1) + struct.pack("<ddq", 3.0, 4.0, -1)
    (folder / "images.bin").write_bytes(content)
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 0))


def images(count: int = 3) -> list[tuple[str, Camera]]:
    return [(f"c{index}/0000.jpg", camera) for index, camera in enumerate(uneven_cameras(count))]


@pytest.fixture
def source(tmp_path: Path) -> Path:
    for index in range(3):
        write_pictures(tmp_path / "images" / f"c{index}", ["0000.jpg", "0001.jpg"])
    return tmp_path


@pytest.mark.parametrize("kind", list(MODELS))
@pytest.mark.parametrize("folder", [".", "sparse/0"])
def test_cameras_project_as_the_originals(source: Path, kind: str, folder: str, rng: np.random.Generator) -> None:
    """Catches distortion coefficients in the wrong order, and a half-pixel shift that is added by mistake."""
    (write_text if folder == "." else write_binary)(source / folder, images(), kind)
    assert detect_format(source) == "colmap"
    imported = read(source)
    assert [camera.name for camera in imported.cameras] == ["c0", "c1", "c2"]
    for camera, original in zip(imported.cameras, uneven_cameras(3), strict=True):
        assert_same_view(camera.calibration, expected_camera(original, kind), rng)
        assert file_names(camera.frames) == ["0000.jpg", "0001.jpg"]
    assert "COLMAP's arbitrary unit" in imported.notes[0]


def test_images_without_folders_and_videos(tmp_path: Path) -> None:
    """Catches an importer that does not match images named CAM.jpg with cameras."""
    write_text(tmp_path / "sparse", [(f"{name[:2]}.jpg", camera) for name, camera in images()])
    for index in range(3):
        write_video(tmp_path / "videos" / f"c{index}.mp4")
    assert [camera.name for camera in read(tmp_path).cameras] == ["c0", "c1", "c2"]


def test_images_of_a_camera_must_agree(source: Path) -> None:
    """Catches a moving camera that is imported as a static camera."""
    static = replace(uneven_cameras(1)[0], translation=uneven_cameras(1)[0].translation + 1e-4)
    write_text(source, [*images(), ("c0/0001.jpg", static)])
    assert len(read(source).cameras) == 3
    moved = replace(static, translation=static.translation + 0.05)
    write_text(source, [*images(), ("c0/0001.jpg", moved)])
    assert_refused(read, source, r"camera 'c0': expected a static camera, got poses of c0/0000.jpg and c0/0001.jpg .*")
    write_text(source, [*images(), ("other/c0/0001.jpg", static)])
    assert_refused(read, source, r"camera 'c0': expected each camera once, got two folders with this name; rename one")
    write_text(source, [*images(), ("c0/0001.jpg", static)])
    edit(source / "images.txt", "1 c0/0001.jpg", "2 c0/0001.jpg")
    with (source / "cameras.txt").open("a") as file:
        file.write(f"2 PINHOLE {WIDTH} {HEIGHT} 50 50 11 8\n")
    assert_refused(
        read,
        source,
        r"camera 'c0': expected the same intrinsics for all images, got different intrinsics for c0/0000.jpg and c0/",
    )


def test_invalid_values_are_reported(source: Path) -> None:
    write_text(source, images())
    whole = (source / "cameras.txt").read_text()
    edit(source / "cameras.txt", "OPENCV", "OPENCV_FISHEYE")
    assert_refused(read, source, r"camera 'c0': expected a lens model among .*, got OPENCV_FISHEYE; undistort the")
    (source / "cameras.txt").write_text("nonsense here\n")
    assert_refused(read, source, r"expected a COLMAP model, got '.*'; copy or reconstruct it again")
    (source / "cameras.txt").write_text(whole.replace("31.0", "-31.0"))
    assert_refused(read, source, r"camera 'c0': intrinsics: expected positive focal lengths")
    (source / "cameras.txt").write_text(whole)
    (source / "images.txt").write_text("")
    assert_refused(read, source, r"expected images with poses, got none; reconstruct again")
    (source / "points3D.txt").unlink()
    assert_refused(read, source, r"expected a COLMAP model, got '.*'; copy or reconstruct it again")
    (source / "cameras.txt").unlink()
    assert_refused(
        read, source, r"expected cameras.bin and images.bin \(or .txt\) in this folder or in sparse/0, got none"
    )


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_truncated_files_are_reported(source: Path, name: str) -> None:
    """Catches a truncated file at which pycolmap hangs or reads beyond the end."""
    write_binary(source, images(), "OPENCV")
    content = (source / name).read_bytes()
    for cut in (content[: len(content) // 2], content[:-3], b"\xff" * 7 + b"\x0f" + content[8:], b""):
        (source / name).write_bytes(cut)
        assert_refused(read, source, rf"{name}: expected a whole file, got a truncated one; copy it again")


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_a_name_that_is_not_utf8_is_reported(source: Path, write: Callable[..., None]) -> None:
    """Catches a UnicodeDecodeError, which pycolmap raises only when the name is read."""
    write(source, images(), "OPENCV")
    file = next(source.glob("images.*"))
    file.write_bytes(file.read_bytes().replace(b"c1/0000.jpg", b"c1/\xff000.jpg"))
    assert_refused(read, source, "expected image names in UTF-8, got other bytes; rename the image")


def test_damaged_files_are_reported(source: Path, rng: np.random.Generator) -> None:
    write_text(source, images())
    assert_damage_is_reported(read, source, source / "images.txt", rng)


def test_photos_of_a_static_scene_are_cameras(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a folder of photos that is not read, although each photo belongs to a separate camera."""
    cameras = uneven_cameras(3)
    write_text(tmp_path / "sparse" / "0", [(f"IMG_{i}.jpg", camera) for i, camera in enumerate(cameras)], "PINHOLE")
    write_pictures(tmp_path / "images", ["IMG_0.jpg", "IMG_1.jpg", "IMG_2.jpg"])
    assert detect_format(tmp_path) == "colmap"
    imported = read(tmp_path)
    assert [camera.name for camera in imported.cameras] == ["IMG_0", "IMG_1", "IMG_2"]
    for camera, original in zip(imported.cameras, cameras, strict=True):
        assert file_names(camera.frames) == [f"{camera.name}.jpg"]
        assert_same_view(camera.calibration, expected_camera(original, "PINHOLE"), rng)
