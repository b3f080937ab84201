"""COLMAP: a sparse model, text or binary, of cameras that stand still, beside each one's video or pictures.

The model's images are named CAM/FRAME.jpg, or CAM.jpg. COLMAP counts pixels from the first one's corner, as here.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.importing.formats.folders import entries, frames_in, lens, with_lenses
from fourd.importing.formats.imported import Imported

MODELS = (".", "sparse", "sparse/0")
LENS_MODELS = {
    "SIMPLE_PINHOLE": (1, 0),
    "PINHOLE": (2, 0),
    "SIMPLE_RADIAL": (1, 1),
    "RADIAL": (1, 2),
    "OPENCV": (2, 4),
    "FULL_OPENCV": (2, 8),
}
"""Numbers of focal lengths and of coefficients, which stand before and after the centre, in OpenCV's order."""
PARAMETERS = {0: 3, 1: 4, 2: 4, 3: 5, 4: 8, 5: 8, 6: 12, 7: 5, 8: 4, 9: 5, 10: 12}
"""How many a lens model of that id has in cameras.bin."""
MOST_TURN = 1e-3
"""Radians by which images of a camera that stands still may differ, and the same of the rig's size for places."""


def looks_like(source: Path) -> bool:
    """Whether ``source``, its sparse/ or its sparse/0/ holds a model."""
    return _model(source) is not None


def read(source: Path) -> Imported:
    """Cameras of ``source``, a folder with the model and the videos or pictures, in the model's unit of length.

    Raises:
        UserError: when the model is damaged, a lens model is none of OpenCV's, a camera moves or changes its lens,
            or cameras do not match.
    """
    path = _model(source)
    if path is None:
        raise UserError(f"{source}: expected cameras.bin and images.bin (or .txt) there or in sparse/0, got none; add")
    lenses = read_lenses(path)
    cameras, notes = with_lenses(frames_in(source), lenses, path)
    unit = "lengths are in the model's own unit, which is arbitrary: COLMAP does not know metres"
    return Imported(cameras, (unit, *notes))


def read_lenses(path: Path) -> dict[str, Camera]:
    """The cameras of a model's folder by name. Raises UserError as read."""
    model = _loaded(path)
    images: dict[str, list[Any]] = defaultdict(list)
    for image in sorted((model.images[number] for number in model.reg_image_ids()), key=lambda image: image.name):
        file = PurePosixPath(image.name.replace("\\", "/"))
        images[file.parent.as_posix() if file.parent.name else file.stem].append(image)
    if not images:
        raise UserError(f"{path}: expected images with poses, got none; reconstruct again")
    poses = {camera: [_pose(image) for image in of_camera] for camera, of_camera in images.items()}
    centres = np.array([-pose[:, :3].T @ pose[:, 3] for of_camera in poses.values() for pose in of_camera])
    size = float(np.linalg.norm(np.ptp(centres, axis=0)))
    lenses: dict[str, Camera] = {}
    for place, of_camera in images.items():
        name = PurePosixPath(place).name
        where = f"{path}: camera '{name}'"
        if name in lenses:
            raise UserError(f"{where}: expected each camera once, got two folders of that name; rename one")
        lenses[name] = _lens(where, model, of_camera, poses[place], size)
    return lenses


def _lens(where: str, model: Any, images: list[Any], poses: list[np.ndarray], rig_size: float) -> Camera:
    """The lens of a camera's first image, with which its others must agree."""
    camera, pose = model.cameras[images[0].camera_id], poses[0]
    for image, other in zip(images[1:], poses[1:], strict=True):
        turn = float(np.linalg.norm(other[:, :3] - pose[:, :3])) / np.sqrt(2)
        way = float(np.linalg.norm(other[:, :3].T @ other[:, 3] - pose[:, :3].T @ pose[:, 3]))
        if not (turn <= MOST_TURN and way <= MOST_TURN * rig_size):
            raise UserError(
                f"{where}: expected a camera that stands still, got {images[0].name} and {image.name} "
                f"{turn:.2g} rad and {way:.2g} units apart; leave the moving camera out"
            )
        again = model.cameras[image.camera_id]
        if again.model != camera.model or not np.allclose(again.params, camera.params, rtol=1e-3, atol=1e-3):
            raise UserError(
                f"{where}: expected one lens, got others for {images[0].name} and {image.name}; "
                "reconstruct with one camera per folder"
            )
    kind = camera.model.name
    if kind not in LENS_MODELS:
        raise UserError(
            f"{where}: expected a lens model among {', '.join(LENS_MODELS)}, got {kind}; "
            "undistort the pictures by COLMAP, or reconstruct with OPENCV"
        )
    focals, coefficients = LENS_MODELS[kind]
    values = np.asarray(camera.params, np.float64)
    centre_x, centre_y = values[focals : focals + 2]
    intrinsics = np.array([[values[0], 0, centre_x], [0, values[focals - 1], centre_y], [0, 0, 1]])
    distortion = np.zeros(max(coefficients, 4))
    distortion[:coefficients] = values[focals + 2 :]
    return lens(where, intrinsics, pose[:, :3], pose[:, 3], (camera.width, camera.height), distortion)


def _pose(image: Any) -> np.ndarray:
    """(3, 4) world-to-camera; a method since pycolmap 3.12."""
    pose = image.cam_from_world
    return np.asarray((pose() if callable(pose) else pose).matrix(), np.float64)


def _loaded(path: Path) -> Any:
    # Only here: pycolmap takes over the process's handling of signals when it is imported.
    import pycolmap

    if (path / "cameras.bin").is_file():
        _check_whole(path)
    try:
        return pycolmap.Reconstruction(str(path))
    except (ValueError, IndexError, KeyError, RuntimeError, MemoryError, OSError) as error:
        reason = str(error).partition("\n")[0].strip()
        raise UserError(f"{path}: expected a COLMAP model, got '{reason}'; copy or reconstruct it again") from error


def _check_whole(path: Path) -> None:
    """Refuse files that end early, of which pycolmap reads what is not there, or never comes back.

    Raises UserError.
    """
    for name in ("rigs.bin", "cameras.bin", "frames.bin", "images.bin", "points3D.bin"):
        file = path / name
        if not file.is_file():
            continue
        try:
            content = file.read_bytes() if name in ("cameras.bin", "images.bin") else b""
            with open(file, "rb") as opened:
                (count,) = struct.unpack("<Q", opened.read(8))
            if 8 + 8 * count > file.stat().st_size:
                raise ValueError
            if content:
                place = 8
                for _ in range(count):
                    place = _after_camera(content, place) if name == "cameras.bin" else _after_image(content, place)
                if place > len(content):
                    raise ValueError
        except (struct.error, ValueError, OSError) as error:
            raise UserError(f"{file}: expected a whole file, got one that ends early; copy it again") from error


def _after_camera(content: bytes, place: int) -> int:
    _, kind, _, _ = struct.unpack_from("<IiQQ", content, place)
    return place + 24 + 8 * PARAMETERS.get(kind, 3)


def _after_image(content: bytes, place: int) -> int:
    name = place + 4 + 56 + 4
    end = content.index(b"\0", name) + 1
    (points,) = struct.unpack_from("<Q", content, end)
    return end + 8 + 24 * int(points)


def _model(source: Path) -> Path | None:
    for place in MODELS:
        found = set(entries(source / place))
        if {"cameras.bin", "images.bin"} <= found or {"cameras.txt", "images.txt"} <= found:
            return source / place
    return None
