"""DNA-Rendering: NAME.smc (HDF5) with encoded images, NAME_annots.smc with calibration and mattes.

In later parts of the data set, NAME.smc contains the calibration. The matrix RT is a camera-to-world pose in metres.
The data set's tools use OpenCV, in which the origin of pixel coordinates is the centre of the first pixel. In fourd,
the origin is the corner of the first pixel, so half a pixel is added to the principal points.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from fourd.cameras import Camera
from fourd.capture.decoding import PICTURE_FORMATS
from fourd.errors import UserError
from fourd.importing.folders import list_entries, make_camera, parse_numbers, read_head
from fourd.importing.imported import EncodedPictures, Imported, ImportedCamera
from fourd.limits import require_regular

SUFFIX = ".smc"
ANNOTATIONS = "_annots.smc"
MAGIC = b"\x89HDF\r\n\x1a\n"
GROUPS = ("Camera_5mp", "Camera_12mp")
MAX_SOFT_LINKS = 16
HEADER_BYTES = 1 << 16
"""Number of bytes at the start of an encoded image that contain the image's width and height."""


def looks_like(source: Path) -> bool:
    """Whether ``source`` is a file NAME.smc, or a folder with such a file."""
    return any(read_head(path, len(MAGIC)) == MAGIC for path in _find_files(source))


def read(source: Path) -> Imported:
    """Read the cameras of ``source``.

    Lengths are in metres. Camera names are two-digit numbers. Images are read one at a time.

    Raises:
        UserError: when there is no NAME.smc or more than one, the file is not HDF5, the file refers to other files, a
            group or a value is missing, or the numbers of mattes and images differ.
    """
    files = _find_files(source)
    if len(files) != 1:
        got = " and ".join(path.name for path in files) or "none"
        raise UserError(f"{source}: expected one NAME{SUFFIX}, got {got}; name the file itself")
    path, annotations = files[0], _find_annotations(files[0])
    pictures: dict[int, tuple[EncodedPictures, tuple[int, int]]] = {}
    with _Smc(path) as main:
        for group in GROUPS:
            for number, group_path in main.numbered(group, required=False).items():
                pictures[number] = main.encoded(f"{group_path}/color")
        if not pictures:
            raise UserError(f"{path}: expected the group {' or '.join(GROUPS)}, got neither; download it again")
        has_calibration = main.has("Camera_Parameter")
        calibrations = _read_cameras(main, pictures) if has_calibration else {}
    masks: dict[int, EncodedPictures] = {}
    if annotations is not None:
        with _Smc(annotations) as annotated:
            if not has_calibration:
                calibrations = _read_cameras(annotated, pictures)
            for number, group_path in annotated.numbered("Mask", required=False).items():
                masks[number] = annotated.encoded(f"{group_path}/mask")[0]
    elif not has_calibration:
        raise UserError(
            f"{path}: expected the group Camera_Parameter in this file or in {path.stem}{ANNOTATIONS}, got neither; "
            "put the annotations beside this file"
        )
    cameras = []
    for number, (frames, _) in sorted(pictures.items()):
        mattes = masks.get(number)
        if mattes is not None and mattes.count != frames.count:
            raise UserError(
                f"{annotations}: Mask/{number}: expected {frames.count} mattes, one for each image, "
                f"got {mattes.count}; download it again"
            )
        cameras.append(ImportedCamera(f"{number:02d}", calibrations.get(number), frames, mattes))
    notes = [
        "metres are kept; poses are inverted from camera-to-world to world-to-camera",
        "half a pixel is added to the principal points, because the origin was the first pixel's centre",
        "colours are kept: Color_Calibration is not applied",
    ]
    uncalibrated = [camera.name for camera in cameras if camera.calibration is None]
    notes += [f"without calibration: {', '.join(uncalibrated)}"] if uncalibrated else []
    return Imported(tuple(cameras), tuple(notes))


class _Smc:
    """An open HDF5 file. The error messages of this class name the file and the group."""

    def __init__(self, path: Path) -> None:
        import h5py  # h5py is imported here, because no other format needs it.

        self.path = path
        self.h5py = h5py
        try:
            require_regular(path)
            self.file = h5py.File(path, "r")
        except OSError as error:
            reason = str(error).partition("\n")[0]
            raise UserError(f"{path}: expected HDF5, got '{reason}'; download it again") from error

    def __enter__(self) -> _Smc:
        return self

    def __exit__(self, *exception: object) -> None:
        self.file.close()

    def has(self, name: str) -> bool:
        with self._report_errors(name):
            return self._resolve(name) is not None

    def numbered(self, name: str, required: bool = True) -> dict[int, str]:
        """Return the paths of a group's members by number, in ascending order.

        Returns no paths if a group that is not ``required`` is missing.
        """
        with self._report_errors(name):
            group = self._get(name)
            if group is None and not required:
                return {}
            if not isinstance(group, self.h5py.Group):
                raise UserError(f"{self.path}: expected the group {name}, got none; download it again")
            members = [str(member) for member in group]
        if not all(member.isdecimal() for member in members) or len({int(member) for member in members}) < len(members):
            raise UserError(
                f"{self.path}: {name}: expected numbers as names, got {', '.join(members)}; download it again"
            )
        return {int(member): f"{name}/{member}" for member in sorted(members, key=int)}

    def encoded(self, name: str) -> tuple[EncodedPictures, tuple[int, int]]:
        """Return a group's images ordered by number, and (width, height) of the first image."""
        paths = list(self.numbered(name).values())
        if not paths:
            raise UserError(f"{self.path}: {name}: expected images, got none; download it again")
        head = self.content(paths[0], HEADER_BYTES)
        try:
            with Image.open(io.BytesIO(head), formats=PICTURE_FORMATS) as image:
                size, suffix = image.size, {"JPEG": ".jpg", "PNG": ".png"}[image.format or ""]
        except (OSError, ValueError, SyntaxError, KeyError, Image.DecompressionBombError) as error:
            raise UserError(
                f"{self.path}: {paths[0]}: expected a JPEG or PNG, got something else; download it again"
            ) from error
        return EncodedPictures(len(paths), suffix, partial(_read_picture, self.path, tuple(paths))), size

    def array(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Read a dataset of finite numbers with the shape ``shape``. With the shape (-1,), the dataset is flattened."""
        with self._report_errors(name):
            value = self._dataset(name)[()]
        return parse_numbers(f"{self.path}: {name}", np.ravel(value) if shape == (-1,) else value, shape)

    def content(self, name: str, max_bytes: int | None = None) -> bytes:
        """Read the bytes of an encoded image, or only its first ``max_bytes`` bytes."""
        with self._report_errors(name):
            dataset = self._dataset(name)
            if dataset.dtype != np.uint8 or dataset.ndim != 1:
                raise UserError(
                    f"{self.path}: {name}: expected the bytes of an image, got {dataset.dtype}; download it again"
                )
            return bytes(dataset[:max_bytes].tobytes())

    def _dataset(self, name: str) -> Any:
        dataset = self._get(name)
        if not isinstance(dataset, self.h5py.Dataset):
            raise UserError(f"{self.path}: expected {name}, got none; download it again")
        if dataset.external:
            raise self._outside(name, "external storage")
        if dataset.is_virtual:
            raise self._outside(name, "a virtual dataset")
        return dataset

    def _get(self, name: str) -> Any:
        path = self._resolve(name)
        return None if path is None else self.file[path]

    def _resolve(self, name: str) -> str | None:
        """Resolve the soft links in the path of an object. Returns None if the object is missing.

        External links are rejected before the linked file is opened. An import that followed external links would copy
        the content of files outside the source.
        """
        path, parts, soft_links = "/", name.split("/"), 0
        while parts:
            part = parts.pop(0)
            if part in ("", "."):
                continue
            parent = self.file[path]
            link = parent.get(part, getlink=True) if isinstance(parent, self.h5py.Group) else None
            if link is None:
                return None
            if isinstance(link, self.h5py.ExternalLink):
                raise self._outside(name, f"a link to {link.filename}")
            if isinstance(link, self.h5py.SoftLink):
                soft_links += 1
                if soft_links > MAX_SOFT_LINKS:
                    return None
                path = "/" if link.path.startswith("/") else path
                parts = link.path.split("/") + parts
            else:
                path = f"{path.rstrip('/')}/{part}"
        return path

    def _outside(self, name: str, got: str) -> UserError:
        return UserError(f"{self.path}: {name}: expected data within this file, got {got}; download it again")

    @contextmanager
    def _report_errors(self, name: str) -> Iterator[None]:
        """Convert the exceptions that h5py raises for damaged files to UserErrors."""
        try:
            yield
        except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
            reason = str(error).partition("\n")[0]
            raise UserError(f"{self.path}: {name}: expected intact HDF5, got '{reason}'; download it again") from error


def _read_picture(path: Path, datasets: tuple[str, ...], index: int) -> bytes:
    with _Smc(path) as smc:
        return smc.content(datasets[index])


def _read_cameras(smc: _Smc, pictures: dict[int, tuple[EncodedPictures, tuple[int, int]]]) -> dict[int, Camera]:
    """Read the calibrations of the cameras in ``pictures`` from the group Camera_Parameter.

    ``pictures`` also contains the image sizes. Returns cameras by number.
    """
    cameras = {}
    for number, group_path in smc.numbered("Camera_Parameter").items():
        if number not in pictures:
            continue
        intrinsics = smc.array(f"{group_path}/K", (3, 3))
        intrinsics[:2, 2] += 0.5
        pose_world_camera = smc.array(f"{group_path}/RT", (4, 4))
        R_camera_world = pose_world_camera[:3, :3].T
        translation = -R_camera_world @ pose_world_camera[:3, 3]
        distortion = smc.array(f"{group_path}/D", (-1,))
        where = f"{smc.path}: {group_path}"
        cameras[number] = make_camera(where, intrinsics, R_camera_world, translation, pictures[number][1], distortion)
    return cameras


def _find_files(source: Path) -> list[Path]:
    candidates = [source / name for name in list_entries(source)] or [source]
    return [path for path in candidates if path.name.endswith(SUFFIX) and not path.name.endswith(ANNOTATIONS)]


def _find_annotations(path: Path) -> Path | None:
    """Find NAME_annots.smc beside NAME.smc or in ../annotations/. In the data set, annotations/ is beside main/."""
    name = f"{path.stem}{ANNOTATIONS}"
    paths = [path.with_name(name), path.parent.parent / "annotations" / name]
    return next((found for found in paths if found.is_file()), None)
