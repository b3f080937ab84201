"""Reading and writing of EasyMocap's calibration files, intri.yml and extri.yml, in OpenCV's FileStorage format."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.formats.opencv_yaml import OpenCvYaml
from fourd.base.formats.opencv_yaml_writer import Value, escape_key, write_opencv_yaml
from fourd.base.limits import MAX_CALIBRATION_BYTES, read_text_limited
from fourd.base.units import MAX_UNIT_M, MIN_UNIT_M
from fourd.recording.capture.focus import describe_inverted, is_reflection
from fourd.recording.capture.layout import EXTRINSICS_NAME, INTRINSICS_NAME

Array = NDArray[np.float64]

MAX_NAME_BYTES = 200
"""Maximum length of a camera name in UTF-8. File systems allow 255 bytes; the rest is for suffixes and for the prefixes
of temporary files."""
UNIT_KEY = "metres_per_unit"
"""Key of extri.yml: the length of a world unit in metres. Other programs ignore this key."""
_LENS_KEYS = ("K", "D", "dist", "H", "W")
_POSE_KEYS = ("R", "Rot", "T")
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
            ValueError: if a value is invalid; see :class:`fourd.base.cameras.Camera`.
        """
        return Camera(self.intrinsics, self.rotation, self.translation, width, height, self.distortion)


@dataclass(frozen=True)
class CalibrationReport:
    """Content and errors of the calibration files.

    Attributes:
        names: names of the cameras of which both files have values, including invalid values.
        calibrations: the valid calibrations, keyed by camera name.
        errors: all errors found in the two files.
        incomplete: the cameras of which only one file has values; keyed by camera name, with the name of that file.
        metres_per_unit: length of a world unit in metres, or None if extri.yml does not state it.
    """

    names: tuple[str, ...]
    calibrations: dict[str, Calibration]
    errors: tuple[UserError, ...]
    incomplete: dict[str, str] = field(default_factory=dict)
    metres_per_unit: float | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """One line for each file that has cameras that the other file lacks."""
        lines = []
        for file, lacks in ((INTRINSICS_NAME, "pose"), (EXTRINSICS_NAME, "intrinsics")):
            names = [name for name, only in self.incomplete.items() if only == file]
            if names:
                lines.append(f"cameras without {lacks}, because only {file} has them, not used: {', '.join(names)}")
        return tuple(lines)


def read_calibration(folder: Path | str) -> dict[str, Calibration]:
    """Read the calibrations in ``folder``. The result is keyed by camera name, in the order of ``names`` in intri.yml.
    Cameras of which only one of the two files has values are left out.

    For each camera with the name c, the function reads these keys:
    - ``K_c``: intrinsics (3, 3) in pixels;
    - ``D_c`` or ``dist_c`` (optional): OpenCV distortion coefficients; EasyMocap's tools write ``dist_c``;
    - ``H_c`` and ``W_c`` (optional): height and width in pixels;
    - ``Rot_c`` (3, 3) or ``R_c`` (Rodrigues vector): rotation R;
    - ``T_c`` (3,): translation T, with ``x_camera = R * x_world + T``.

    The optional key ``metres_per_unit`` of extri.yml is in the result of :func:`require_calibration`.

    Characters of a name that OpenCV cannot read in a key are escaped in the keys; see
    :func:`~fourd.base.formats.opencv_yaml_writer.escape_key`.

    Raises:
        UserError: if a file is missing or is not an OpenCV FileStorage, a value is missing, has a wrong shape or is not
            finite, a rotation matrix is not orthonormal or mirrors, no camera has values in both files, or the poses
            are surely camera-to-world poses. The message contains the file and the key.
    """
    return require_calibration(folder).calibrations


def require_calibration(
    folder: Path | str, files: tuple[Path | str, Path | str] = (INTRINSICS_NAME, EXTRINSICS_NAME)
) -> CalibrationReport:
    """Read the calibrations like :func:`read_calibration`, with the cameras that were left out. Raises the same
    errors. ``files`` are the paths of the two files in the folder, if they have other names."""
    report = check_calibration(folder, files)
    if report.errors:
        raise report.errors[0]
    return report


def check_calibration(
    folder: Path | str, files: tuple[Path | str, Path | str] = (INTRINSICS_NAME, EXTRINSICS_NAME)
) -> CalibrationReport:
    """Read the calibrations like :func:`require_calibration`, but collect all errors instead of raising the first."""
    errors: list[UserError] = []
    storages = []
    for file in files:
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
    incomplete = {}
    for name in dict.fromkeys((*names, *others)):
        has_lens, has_pose = intri.has_any(_LENS_KEYS, name), extri.has_any(_POSE_KEYS, name)
        if has_lens != has_pose:
            incomplete[name] = INTRINSICS_NAME if has_lens else EXTRINSICS_NAME
    names = [name for name in names if name not in incomplete]
    calibrations = {}
    for name in names:
        try:
            calibrations[name] = _read_camera(name, intri, extri)
        except UserError as error:
            errors.append(error)
    if not names:
        message = f"expected cameras that are in {EXTRINSICS_NAME} too, got {', '.join(incomplete)}, which are not"
        errors.append(UserError(f"{intri.path}: {message}; calibrate the cameras again"))
    inverted = describe_inverted([each.camera(each.width or 1, each.height or 1) for each in calibrations.values()])
    if inverted is not None and inverted.is_sure:
        errors.append(UserError(f"{extri.path}: {inverted.reason}; invert the poses (R and T) of all cameras"))
    metres_per_unit = None
    try:
        metres_per_unit = extri.metres_per_unit()
    except UserError as error:
        errors.append(error)
    return CalibrationReport(tuple(names), calibrations, tuple(errors), incomplete, metres_per_unit)


def read_intrinsics(folder: Path | str) -> dict[str, Camera]:
    """Read ``folder``/intri.yml and return the cameras, keyed by name. They have the identity pose, because extri.yml
    is not read.

    Raises:
        UserError: in the same cases as :func:`read_calibration`, or if a camera has no image size.
    """
    lenses = {}
    intri = _Storage(Path(folder) / INTRINSICS_NAME)
    for name in intri.names():
        width, height = intri.count("W", name), intri.count("H", name)
        if width is None or height is None:
            raise UserError(f"{intri.path}: expected W_{name} and H_{name} in pixels, got none; add the image size")
        lens = Calibration(
            intri.matrix("K", name, (3, 3)), np.eye(3), np.zeros(3), _read_distortion(name, intri), width, height
        )
        try:
            lenses[name] = lens.camera(width, height)
        except ValueError as error:
            raise UserError(f"{intri.path}: camera '{name}': {error}; calibrate that camera again") from error
    return lenses


def write_calibration(
    folder: Path | str, names: Sequence[str], cameras: Sequence[Camera], metres_per_unit: float | None = None
) -> None:
    """Write intri.yml and extri.yml for ``cameras`` into ``folder``; each file is written atomically.
    ``metres_per_unit`` is the length of a world unit in metres, or None if it is not known.

    Raises:
        ValueError: if a name is not valid; see :func:`camera_name_problem`.
    """
    import cv2  # Only here, so that the names of the files can be read without the import of OpenCV.

    intri: dict[str, Value] = {"names": list(names)}
    extri: dict[str, Value] = {"names": list(names)}
    if metres_per_unit is not None:
        extri[UNIT_KEY] = float(metres_per_unit)
    for name, camera in zip(names, cameras, strict=True):
        problem = camera_name_problem(name)
        if problem is not None:
            raise ValueError(f"camera '{name}': {problem}")
        distortion = camera.distortion if camera.distortion is not None else np.zeros(5)
        intri[_key("K", name)] = np.asarray(camera.intrinsics, np.float64)
        intri[_key("D", name)] = np.asarray(distortion, np.float64).reshape(1, -1)
        intri[_key("H", name)] = int(camera.height)
        intri[_key("W", name)] = int(camera.width)
        extri[_key("R", name)] = np.asarray(cv2.Rodrigues(camera.rotation)[0], np.float64)
        extri[_key("Rot", name)] = np.asarray(camera.rotation, np.float64)
        extri[_key("T", name)] = np.asarray(camera.translation, np.float64).reshape(3, 1)
    write_text_atomically(Path(folder) / INTRINSICS_NAME, write_opencv_yaml(intri))
    write_text_atomically(Path(folder) / EXTRINSICS_NAME, write_opencv_yaml(extri))


def camera_name_problem(name: str) -> str | None:
    """Return what is wrong with a camera name, or None if the name is valid. A valid name can be the name of a folder
    and of a video: it is not empty, it does not start with ``.`` or ``-``, it does not start or end with a space, and
    it contains neither ``/`` nor ``\\`` nor characters that are not printable."""
    if not name or len(name.encode("utf-8", "surrogatepass")) > MAX_NAME_BYTES:
        return f"expected a name of 1 to {MAX_NAME_BYTES} bytes"
    if name[0] in ".-":
        return "expected no dot and no dash at the start of the name"
    if name != name.strip():
        return "expected no space at the start and at the end of the name"
    wrong = next((character for character in name if character in "/\\" or _is_unprintable(character)), None)
    return None if wrong is None else f"expected only printable characters except / and \\ in the name, got {wrong!a}"


def _is_unprintable(character: str) -> bool:
    """Return whether a character is a control character, a line separator, or half of a surrogate pair."""
    return unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp")


def _key(prefix: str, name: str) -> str:
    return escape_key(f"{prefix}_{name}")


def _read_camera(name: str, intri: _Storage, extri: _Storage) -> Calibration:
    intrinsics = intri.matrix("K", name, (3, 3))
    if not np.allclose(intrinsics[2], (0, 0, 1)):
        raise UserError(
            f"{intri.path}: K_{name}: expected a last row of 0 0 1, got {intrinsics[2].tolist()}; calibrate again"
        )
    calibration = Calibration(
        intrinsics,
        _read_rotation(name, extri),
        extri.matrix("T", name, (3,)),
        _read_distortion(name, intri),
        intri.count("W", name),
        intri.count("H", name),
    )
    try:
        calibration.camera(calibration.width or 1, calibration.height or 1)
    except ValueError as error:
        path = extri.path if str(error).startswith("rotation") else intri.path
        raise UserError(f"{path}: camera '{name}': {error}; calibrate that camera again") from error
    return calibration


def _read_distortion(name: str, intri: _Storage) -> Array | None:
    return next((intri.matrix(key, name, None) for key in ("D", "dist") if intri.has(key, name)), None)


def _read_rotation(name: str, extri: _Storage) -> Array:
    """Read the rotation from the key Rot_c, or from R_c if there is no Rot_c. If both exist, they must describe the
    same rotation."""
    if not extri.has("R", name):
        if extri.matrix("Rot", name, None).size == 3:
            raise UserError(
                f"{extri.path}: Rot_{name}: expected a rotation matrix of 3 x 3 numbers, got 3 numbers; if they are a "
                f"rotation vector (Rodrigues), rename the key to R_{name}"
            )
        return extri.matrix("Rot", name, (3, 3))
    import cv2

    vector = extri.matrix("R", name, None)
    if vector.size not in (3, 9):
        raise UserError(f"{extri.path}: R_{name}: expected 3 numbers (Rodrigues), got {vector.size}; correct the value")
    from_vector = vector.reshape(3, 3) if vector.size == 9 else np.asarray(cv2.Rodrigues(vector)[0], np.float64)
    if not extri.has("Rot", name):
        return from_vector
    rotation = extri.matrix("Rot", name, (3, 3))
    error = float(np.abs(rotation - from_vector).max())
    # Matrices that are no rotations are reported as such when the camera is made.
    is_rotation = np.abs(rotation @ rotation.T - np.eye(3)).max() < MAX_ROTATION_DIFFERENCE
    is_rotation &= not is_reflection(rotation)
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

    def metres_per_unit(self) -> float | None:
        """Read the length of a world unit in metres; return None if the key is missing."""
        if UNIT_KEY not in self._content:
            return None
        value = self._content.number(UNIT_KEY)
        if value is None or not MIN_UNIT_M <= value <= MAX_UNIT_M:
            got = "another type" if value is None else f"{value:g}"
            raise UserError(
                f"{self.path}: {UNIT_KEY}: expected the length of a world unit in metres, such as 1 or 0.001, got "
                f"{got}; correct or remove the value"
            )
        return value

    def has(self, prefix: str, name: str) -> bool:
        return self._found(prefix, name) in self._content

    def has_any(self, prefixes: Sequence[str], name: str) -> bool:
        return any(self.has(prefix, name) for prefix in prefixes)

    def _found(self, prefix: str, name: str) -> str:
        """Return the key of a value: escaped as fourd writes it, or as other programs may write it."""
        escaped = _key(prefix, name)
        return escaped if escaped in self._content else f"{prefix}_{name}"

    def names(self, required: bool = True) -> list[str]:
        if "names" not in self._content and not required:
            return []
        names = self._content.strings("names") if "names" in self._content else None
        if not names:
            raise UserError(
                f'{self.path}: names: expected a list of camera names such as "00", got no list; add the list'
            )
        if len(set(names)) != len(names):
            raise UserError(
                f"{self.path}: names: expected each camera once, got {', '.join(names)}; remove the duplicates"
            )
        return names

    def matrix(self, prefix: str, name: str, shape: tuple[int, ...] | None) -> Array:
        """Read a finite matrix of the given shape; if the shape is None, read any matrix and flatten it."""
        key = self._found(prefix, name)
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

    def count(self, prefix: str, name: str) -> int | None:
        """Read a whole number of pixels; return None if the key is missing or the number is 0."""
        key = self._found(prefix, name)
        if key not in self._content:
            return None
        value = self._content.number(key)
        if value is None or not (np.isfinite(value) and value == round(value) and 0 <= value <= 1 << 20):
            got = "another type" if value is None else f"{value:g}"
            raise UserError(f"{self.path}: {key}: expected a number of pixels, got {got}; correct or remove the value")
        return int(value) or None
