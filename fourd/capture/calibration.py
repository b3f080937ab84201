"""Reading and writing of EasyMocap's calibration files, intri.yml and extri.yml, in OpenCV's FileStorage format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.files import write_text_atomically
from fourd.formats.opencv_yaml import OpenCvYaml
from fourd.limits import MAX_CALIBRATION_BYTES, read_text_limited

Array = NDArray[np.float64]

INTRINSICS_NAME = "intri.yml"
EXTRINSICS_NAME = "extri.yml"
MAX_ROTATION_DIFFERENCE = 1e-3
"""Maximum absolute difference between corresponding elements of two rotation matrices of a camera c in extri.yml: the
matrix stored as Rot_c, and the matrix computed from the Rodrigues vector stored as R_c."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """One camera's calibration as stored in the files.

    Attributes:
        intrinsics: (3, 3) matrix K in pixels.
        rotation: (3, 3) rotation R from world to camera.
        translation: (3,) translation t in world units, with x_camera = R * x_world + t.
        distortion: OpenCV distortion coefficients, or None if intri.yml does not contain them.
        width: width of the images in pixels, or None if intri.yml does not contain the width.
        height: height of the images in pixels, or None if intri.yml does not contain the height.
    """

    intrinsics: Array
    rotation: Array
    translation: Array
    distortion: Array | None
    width: int | None
    height: int | None

    def camera(self, width: int, height: int) -> Camera:
        """Create the camera for images of ``width`` x ``height`` pixels.

        Raises:
            ValueError: if a value is invalid; see :class:`fourd.cameras.Camera`.
        """
        return Camera(self.intrinsics, self.rotation, self.translation, width, height, self.distortion)


@dataclass(frozen=True)
class CalibrationReport:
    """Content and errors of the calibration files.

    Attributes:
        names: names of all cameras in intri.yml, including cameras with invalid values.
        calibrations: the valid calibrations, keyed by camera name.
        errors: all errors found in the two files.
    """

    names: tuple[str, ...]
    calibrations: dict[str, Calibration]
    errors: tuple[UserError, ...]


def read_calibration(folder: Path | str) -> dict[str, Calibration]:
    """Read the calibrations in ``folder``. The result is keyed by camera name, in the order of ``names`` in intri.yml.

    For each camera with the name c, the function reads these keys:
    - ``K_c``: intrinsics (3, 3) in pixels;
    - ``D_c`` or ``dist_c`` (optional): OpenCV distortion coefficients; EasyMocap's tools write ``dist_c``;
    - ``H_c`` and ``W_c`` (optional): height and width in pixels;
    - ``Rot_c`` (3, 3) or ``R_c`` (Rodrigues vector): rotation R;
    - ``T_c`` (3,): translation T, with ``x_camera = R * x_world + T``.

    Raises:
        UserError: if a file is missing or is not an OpenCV FileStorage, a value is missing, has a wrong shape or is not
            finite, or a rotation matrix is not orthonormal. The message contains the file and the key.
    """
    report = check_calibration(folder)
    if report.errors:
        raise report.errors[0]
    return report.calibrations


def check_calibration(folder: Path | str) -> CalibrationReport:
    """Read the calibrations like :func:`read_calibration`, but collect all errors instead of raising the first."""
    errors: list[UserError] = []
    storages = []
    for file in (INTRINSICS_NAME, EXTRINSICS_NAME):
        try:
            storages.append(_Storage(Path(folder) / file))
        except UserError as error:
            errors.append(error)
    if len(storages) < 2:
        return CalibrationReport((), {}, tuple(errors))
    intri, extri = storages
    try:
        names, others = intri.names(), extri.names(required=False)
    except UserError as error:
        return CalibrationReport((), {}, (error,))
    known = set(names)
    for name in others:
        if name not in known:
            message = (
                f"expected camera '{name}', which is in {EXTRINSICS_NAME}, got no such camera; add the camera "
                f"or remove it from {EXTRINSICS_NAME}"
            )
            errors.append(UserError(f"{intri.path}: {message}"))
    calibrations = {}
    for name in names:
        try:
            calibrations[name] = _read_camera(name, intri, extri)
        except UserError as error:
            errors.append(error)
    return CalibrationReport(tuple(names), calibrations, tuple(errors))


def read_intrinsics(folder: Path | str) -> dict[str, Camera]:
    """Read ``folder``/intri.yml and return the cameras, keyed by name. They have the identity pose, because extri.yml
    is not read.

    Raises:
        UserError: in the same cases as :func:`read_calibration`, or if a camera has no image size.
    """
    lenses = {}
    intri = _Storage(Path(folder) / INTRINSICS_NAME)
    for name in intri.names():
        width, height = intri.count(f"W_{name}"), intri.count(f"H_{name}")
        if width is None or height is None:
            raise UserError(f"{intri.path}: expected W_{name} and H_{name} in pixels, got none; add the image size")
        lens = Calibration(
            intri.matrix(f"K_{name}", (3, 3)), np.eye(3), np.zeros(3), _read_distortion(name, intri), width, height
        )
        try:
            lenses[name] = lens.camera(width, height)
        except ValueError as error:
            raise UserError(f"{intri.path}: camera '{name}': {error}; calibrate that camera again") from error
    return lenses


def write_calibration(folder: Path | str, names: Sequence[str], cameras: Sequence[Camera]) -> None:
    """Write intri.yml and extri.yml for ``cameras`` into ``folder``; each file is written atomically."""
    folder = Path(folder)
    intri, extri = _new_storage(names), _new_storage(names)
    for name, camera in zip(names, cameras, strict=True):
        distortion = camera.distortion if camera.distortion is not None else np.zeros(5)
        intri.write(f"K_{name}", camera.intrinsics)
        intri.write(f"D_{name}", distortion.reshape(1, -1))
        intri.write(f"H_{name}", camera.height)
        intri.write(f"W_{name}", camera.width)
        extri.write(f"R_{name}", cv2.Rodrigues(camera.rotation)[0])
        extri.write(f"Rot_{name}", camera.rotation)
        extri.write(f"T_{name}", camera.translation.reshape(3, 1))
    write_text_atomically(folder / INTRINSICS_NAME, intri.releaseAndGetString())
    write_text_atomically(folder / EXTRINSICS_NAME, extri.releaseAndGetString())


def _new_storage(names: Sequence[str]) -> cv2.FileStorage:
    """Create a FileStorage in memory, and write the camera names to it. (A FileStorage that writes to the disk reports
    no error when the disk is full.)"""
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
    storage = cv2.FileStorage(".yml", flags)
    storage.startWriteStruct("names", cv2.FileNode_SEQ)
    for name in names:
        storage.write("", name)
    storage.endWriteStruct()
    return storage


def _read_camera(name: str, intri: _Storage, extri: _Storage) -> Calibration:
    intrinsics = intri.matrix(f"K_{name}", (3, 3))
    if not np.allclose(intrinsics[2], (0, 0, 1)):
        raise UserError(
            f"{intri.path}: K_{name}: expected a last row of 0 0 1, got {intrinsics[2].tolist()}; calibrate again"
        )
    calibration = Calibration(
        intrinsics,
        _read_rotation(name, extri),
        extri.matrix(f"T_{name}", (3,)),
        _read_distortion(name, intri),
        intri.count(f"W_{name}"),
        intri.count(f"H_{name}"),
    )
    try:
        calibration.camera(calibration.width or 1, calibration.height or 1)
    except ValueError as error:
        path = extri.path if str(error).startswith("rotation") else intri.path
        raise UserError(f"{path}: camera '{name}': {error}; calibrate that camera again") from error
    return calibration


def _read_distortion(name: str, intri: _Storage) -> Array | None:
    return next((intri.matrix(key, None) for key in (f"D_{name}", f"dist_{name}") if intri.has(key)), None)


def _read_rotation(name: str, extri: _Storage) -> Array:
    """Read the rotation from the key Rot_c, or from R_c if there is no Rot_c. If both exist, they must describe the
    same rotation."""
    if not extri.has(f"R_{name}"):
        return extri.matrix(f"Rot_{name}", (3, 3))
    vector = extri.matrix(f"R_{name}", None)
    if vector.size not in (3, 9):
        raise UserError(f"{extri.path}: R_{name}: expected 3 numbers (Rodrigues), got {vector.size}; correct the value")
    from_vector = vector.reshape(3, 3) if vector.size == 9 else np.asarray(cv2.Rodrigues(vector)[0], np.float64)
    if not extri.has(f"Rot_{name}"):
        return from_vector
    rotation = extri.matrix(f"Rot_{name}", (3, 3))
    error = float(np.abs(rotation - from_vector).max())
    is_rotation = np.abs(rotation @ rotation.T - np.eye(3)).max() < MAX_ROTATION_DIFFERENCE
    if is_rotation and error > MAX_ROTATION_DIFFERENCE:
        raise UserError(
            f"{extri.path}: camera '{name}': expected R_{name} and Rot_{name} to be the same rotation, "
            f"got matrices that differ by {error:.3g}; remove the wrong matrix"
        )
    return rotation


class _Storage:
    """The content of a calibration file. The error messages of this class contain the file and the key."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise UserError(
                f"{path}: expected the cameras' calibration, got no such file; calibrate the cameras first "
                f"(a capture consists of images/CAM/, {INTRINSICS_NAME} and {EXTRINSICS_NAME})"
            )
        try:
            self._content = OpenCvYaml(read_text_limited(path, MAX_CALIBRATION_BYTES))
        except ValueError as error:
            got = "another format" if isinstance(error, UnicodeDecodeError) else error
            raise UserError(
                f"{path}: expected OpenCV FileStorage YAML (%YAML:1.0), got {got}; export the file again"
            ) from error

    def has(self, key: str) -> bool:
        return key in self._content

    def names(self, required: bool = True) -> list[str]:
        if "names" not in self._content and not required:
            return []
        entries = self._content.items("names") if "names" in self._content else None
        names = [entry for entry in entries or [] if isinstance(entry, str)]
        if not names or entries is None or len(names) < len(entries):
            raise UserError(
                f'{self.path}: names: expected a list of quoted camera names such as "00", got no list; add the list'
            )
        if len(set(names)) != len(names):
            raise UserError(
                f"{self.path}: names: expected each camera once, got {', '.join(names)}; remove the duplicates"
            )
        return names

    def matrix(self, key: str, shape: tuple[int, ...] | None) -> Array:
        """Read a finite matrix of the given shape; if the shape is None, read any matrix and flatten it."""
        if key not in self._content:
            raise UserError(f"{self.path}: {key}: expected a matrix, got no such key; add the key or remove the camera")
        try:
            matrix = self._content.matrix(key)
        except ValueError as error:
            raise UserError(
                f"{self.path}: {key}: expected a complete matrix, got a truncated one; copy the file again"
            ) from error
        if matrix is None or (shape is not None and matrix.size != int(np.prod(shape))):
            got = "another type" if matrix is None else " x ".join(map(str, matrix.shape))
            required = "a matrix" if shape is None else " x ".join(map(str, shape))
            raise UserError(
                f"{self.path}: {key}: expected {required} numbers, got {got}; correct the value or remove the camera"
            )
        if not np.isfinite(matrix).all():
            raise UserError(
                f"{self.path}: {key}: expected finite numbers, got {matrix.ravel().tolist()}; calibrate again"
            )
        return matrix.reshape(-1 if shape is None else shape)

    def count(self, key: str) -> int | None:
        """Read a whole number of pixels; return None if the key is missing or the number is 0."""
        if key not in self._content:
            return None
        value = self._content.number(key)
        if value is None or not (np.isfinite(value) and value == round(value) and 0 <= value <= 1 << 20):
            got = "another type" if value is None else f"{value:g}"
            raise UserError(f"{self.path}: {key}: expected a number of pixels, got {got}; correct or remove the value")
        return int(value) or None
