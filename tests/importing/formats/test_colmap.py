"""COLMAP: handwritten text and binary models of cameras, where each camera has its own folder of images."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from fourd.base.cameras import Camera
from fourd.recording.importing.formats.colmap import read
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
    assert_refused(
        read, source, r"cameras.txt: line 1: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, got 'nonsense here'; export"
    )
    (source / "cameras.txt").write_text(whole.replace(" 31.0", ""))
    assert_refused(read, source, r"cameras.txt: line 2: expected 8 parameters of the lens model OPENCV, got '1 OPENCV")
    (source / "cameras.txt").write_text(whole.replace("31.0", "-31.0"))
    assert_refused(read, source, r"camera 'c0': intrinsics: expected positive focal lengths")
    (source / "cameras.txt").write_text(whole)
    (source / "images.txt").write_text("")
    assert_refused(read, source, r"expected images with poses, got none; reconstruct again")
    write_text(source, images())
    edit(source / "images.txt", "c0/0000.jpg\n\n", "c0/0000.jpg\n")
    assert_refused(read, source, r"images.txt: line 3: expected points \(X Y POINT3D_ID\) or an empty line, got '2 ")
    write_text(source, images())
    (source / "images.txt").write_text("1 1,0 0 0 0 0 0 3,5 1 c0/0000.jpg\n\n")
    assert_refused(read, source, r"images.txt: line 1: expected numbers with a decimal point, got '1 1,0 0 0 0")
    (source / "images.txt").write_text("1 1.0 0 0 0 0 0 nan 1 c0/0000.jpg\n\n")
    assert_refused(read, source, r"images.txt: line 1: expected finite numbers, got .*nan")
    write_text(source, [("c0/../../x/0.jpg", uneven_cameras(1)[0])])
    assert_refused(read, source, r"expected image names within the folder of the images, got 'c0/../../x/0.jpg'")
    (source / "cameras.txt").unlink()
    assert_refused(
        read, source, r"expected cameras.bin and images.bin \(or .txt\) in this folder or in sparse/0, got none"
    )


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_truncated_files_are_reported(source: Path, name: str) -> None:
    """Catches a truncated file that is read as a smaller model, or beyond its end."""
    write_binary(source, images(), "OPENCV")
    content = (source / name).read_bytes()
    for cut in (content[: len(content) // 2], content[:-3], b"\xff" * 7 + b"\x0f" + content[8:], b""):
        (source / name).write_bytes(cut)
        assert_refused(read, source, rf"{name}: expected a whole file, got a truncated one; copy it again")


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_a_name_that_is_not_utf8_is_reported(source: Path, write: Callable[..., None]) -> None:
    """Catches a UnicodeDecodeError for a name in another encoding."""
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


def write_rig(source: Path, *, moving: bool) -> list[Camera]:
    """Write a model of three cameras on a rig in two frames, with rigs.bin and frames.bin, in the folders of COLMAP's
    tutorial, and return the cameras."""
    model, rig, cameras = pycolmap.Reconstruction(), pycolmap.Rig(rig_id=1), []
    rig_from_world = Rotation.from_euler("y", 0.3), np.array([0.1, 0, 3])
    for number in (1, 2, 3):
        lens = pycolmap.Camera(
            camera_id=number, model="RADIAL", width=WIDTH, height=HEIGHT, params=[FX, CX, CY, K1, K2]
        )
        model.add_camera(lens)
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number)
        turn, shift = Rotation.from_euler("y", 0.2 * (number - 1)), np.array([0.1 * (number - 1), 0, 0])
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn.as_quat()), shift)
        rig.add_ref_sensor(sensor) if number == 1 else rig.add_sensor(sensor, pose)
        rotation, translation = (turn * rig_from_world[0]).as_matrix(), turn.apply(rig_from_world[1]) + shift
        cameras.append(expected_camera(Camera(np.eye(3), rotation, translation, WIDTH, HEIGHT), "RADIAL"))
    model.add_rig(rig)
    for frame_id in (1, 2):
        shift = rig_from_world[1] + (0.1 * frame_id if moving else 0)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rig_from_world[0].as_quat()), shift)
        frame = pycolmap.Frame(frame_id=frame_id, rig_id=1, rig_from_world=pose)
        for number in (1, 2, 3):
            sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number)
            frame.add_data_id(pycolmap.data_t(sensor, 3 * frame_id + number))
        model.add_frame(frame)
        for number in (1, 2, 3):
            name = f"rig1/camera{number}/image{frame_id:04d}.jpg"
            ids = {"camera_id": number, "image_id": 3 * frame_id + number, "frame_id": frame_id}
            model.add_image(pycolmap.Image(name=name, **ids))
            write_pictures(source / "images" / f"rig1/camera{number}", [f"image{frame_id:04d}.jpg"])
        model.register_frame(frame_id)
    (source / "sparse/0").mkdir(parents=True, exist_ok=True)
    model.write_binary(str(source / "sparse/0"))
    return cameras


def test_rigs_in_nested_folders(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches the images of COLMAP's rig tutorial, which are two folders deep, that are not found, poses of a rig
    without the poses of its cameras, and a moving rig that is imported as a static one."""
    originals = write_rig(tmp_path, moving=False)
    imported = read(tmp_path)
    assert [camera.name for camera in imported.cameras] == ["camera1", "camera2", "camera3"]
    for camera, original in zip(imported.cameras, originals, strict=True):
        assert_same_view(camera.calibration, original, rng)
        assert file_names(camera.frames) == ["image0001.jpg", "image0002.jpg"]
    write_rig(tmp_path, moving=True)
    assert_refused(read, tmp_path, r"camera 'camera1': expected a static camera, got poses of rig1/camera1/image0001")


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_any_names_are_found(write: Callable[..., None], tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches names that are cut at a space, comments that are not recognised, line ends of Windows, a model without
    points, and equal names in different folders."""
    names = ["a/cam 1 (left)/0 1.jpg", "b/cam 1 (left)/0 1.jpg", "a/c#2/0 1.jpg", "左.jpg"]
    originals = uneven_cameras(4)
    model = tmp_path / "sparse" / "0"
    write(model, list(zip([*names[:2], names[2].replace("/", "\\"), names[3]], originals, strict=True)), "OPENCV")
    next(model.glob("points3D.*")).unlink()
    for file in model.glob("*.txt"):
        text = file.read_text(encoding="utf-8")
        file.write_bytes(f"\ufeff# a comment\n{text}".replace("\n", "\r\n").encode())
    for name in names:
        write_pictures((tmp_path / "images" / name).parent, [Path(name).name])
    cameras = {camera.name: camera for camera in read(tmp_path).cameras}
    assert set(cameras) == {"a_cam 1 (left)", "b_cam 1 (left)", "a_c#2", "左"}
    for name, original in zip(("a_cam 1 (left)", "b_cam 1 (left)", "a_c#2", "左"), originals, strict=True):
        assert_same_view(cameras[name].calibration, expected_camera(original, "OPENCV"), rng)
        assert len(file_names(cameras[name].frames)) == 1


def test_images_that_the_model_does_not_name(tmp_path: Path) -> None:
    """Catches photos without a pose that are imported with the pose of another photo, or left out without a word, and
    frames of a static camera that are left out."""
    cameras = uneven_cameras(3)
    write_text(tmp_path / "sparse", [(f"IMG_{i}.jpg", camera) for i, camera in enumerate(cameras)])
    write_pictures(tmp_path / "images", ["IMG_0.jpg", "IMG_1.jpg", "IMG_7.jpg"])
    imported = read(tmp_path)
    assert [camera.name for camera in imported.cameras] == ["IMG_0", "IMG_1"]
    assert "photos that the model does not name, not imported: IMG_7.jpg" in imported.notes
    assert "cameras without images, not imported: IMG_2" in imported.notes
    nested = tmp_path / "nested"
    write_text(nested / "sparse", images())
    for name in ("c0", "c1", "c2", "c7"):
        write_pictures(nested / "images" / name, ["0000.jpg", "0001.jpg"])
    imported = read(nested)
    assert [camera.name for camera in imported.cameras] == ["c0", "c1", "c2"]
    assert all(file_names(camera.frames) == ["0000.jpg", "0001.jpg"] for camera in imported.cameras)
    assert any(note.startswith("3 images in the cameras' folders are imported although") for note in imported.notes)
    assert "folders that the model does not name, not imported: c7" in imported.notes


def test_names_relative_to_other_folders(tmp_path: Path) -> None:
    """Catches images that are not found if their names start with the folder of all images, or if the model's folder
    is the source."""
    write_text(tmp_path / "sparse/0", [(f"images/{i}.jpg", camera) for i, camera in enumerate(uneven_cameras(3))])
    write_pictures(tmp_path / "images", ["0.jpg", "1.jpg", "2.jpg"])
    assert [camera.name for camera in read(tmp_path).cameras] == ["0", "1", "2"]
    assert [camera.name for camera in read(tmp_path / "sparse/0").cameras] == ["0", "1", "2"]


def test_videos_are_preferred_to_images(tmp_path: Path) -> None:
    """Catches a recording of which only the frames that COLMAP calibrated are imported."""
    write_text(tmp_path / "sparse/0", images())
    for index in range(3):
        write_pictures(tmp_path / "images" / f"c{index}", ["0000.jpg"])
        write_video(tmp_path / "videos" / f"c{index}.mp4")
    imported = read(tmp_path)
    assert [file_names(camera.frames) for camera in imported.cameras] == [["c0.mp4"], ["c1.mp4"], ["c2.mp4"]]
    assert f"the videos in {tmp_path / 'videos'} are imported, and not the images of the model" in imported.notes


def test_lens_models_of_newer_versions(tmp_path: Path) -> None:
    """Catches lens models that shift the reading of the following cameras, and unknown ones."""
    for kind, parameters in (("RAD_TAN_THIN_PRISM_FISHEYE", 16), ("EUCM", 6), ("SIMPLE_DIVISION", 4)):
        model = pycolmap.Reconstruction()
        for number in (1, 2):
            lens = pycolmap.Camera(camera_id=number, model=kind, width=24, height=16, params=[20.0] * parameters)
            model.add_camera_with_trivial_rig(lens)
            pose = pycolmap.Rigid3d()
            image = pycolmap.Image(name=f"{number}.jpg", camera_id=number, image_id=number)
            model.add_image_with_trivial_frame(image, pose)
        model.write_binary(str(tmp_path))
        write_pictures(tmp_path, ["1.jpg", "2.jpg"])
        assert_refused(read, tmp_path, rf"camera '1': expected a lens model among .*, got {kind}; undistort the images")
    content = bytearray((tmp_path / "cameras.bin").read_bytes())
    content[12:16] = struct.pack("<i", 99)
    (tmp_path / "cameras.bin").write_bytes(content)
    assert_refused(read, tmp_path, r"camera .: expected a lens model among .*, got number 99; undistort the images")
