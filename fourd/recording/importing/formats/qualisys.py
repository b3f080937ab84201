"""Qualisys Track Manager: NAME.qca.txt (XML) beside the videos.

The element ``transform`` of a camera contains a rotation, and the camera's position in the world in millimetres. The
rows of the rotation are the camera's axes x (right), y (up) and z (backwards) in world coordinates. Focal lengths and
principal points are in units of 1/64 sensor pixel. The element ``fov_video`` is the part of the sensor that the video
shows.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.limits import read_limited
from fourd.recording.importing.folders import MAX_VALUE, find_frames, match_names
from fourd.recording.importing.imported import Imported, ImportedCamera

SUBPIXELS = 64
METRES_PER_MM = 1e-3
SUFFIX = ".qca.txt"
MAX_PIXELS = 1 << 20
MAX_SHOWN = 40
"""Maximum number of characters of a wrong value that an error message quotes."""


def looks_like(source: Path) -> bool:
    """Return whether ``source`` is a .qca.txt file, or a folder with one."""
    return _find_file(source) is not None


def is_calibration(path: Path) -> bool:
    """Return whether ``path`` is a file whose name ends in .qca.txt, as the names of Qualisys calibrations do."""
    return path.name.endswith(SUFFIX) and path.is_file()


def read_names(path: Path) -> list[str]:
    """Return the names of the cameras of a calibration file. Raises UserError if the file is invalid."""
    return list(read_cameras(path))


def read(source: Path, frames: Path | None = None) -> Imported:
    """Read the cameras of ``source``: a folder with NAME.qca.txt, or NAME.qca.txt itself.

    Args:
        source: the folder or the file.
        frames: folder that contains the cameras' videos, or None for the folder of NAME.qca.txt.

    Raises:
        UserError: when the XML is invalid, a value is missing, or no camera in the XML has a video.
    """
    path = _find_file(source)
    if path is None:
        raise UserError(f"{source}: expected a folder with NAME{SUFFIX}, got none; export it from Qualisys")
    calibrations, uncalibrated = _read_all(path)
    found_frames = find_frames(frames or path.parent, names=list(calibrations))
    pairs = match_names(list(calibrations), found_frames, path)
    cameras = tuple(
        ImportedCamera(name, calibrations[pairs[name]] if name in pairs else None, found)
        for name, found in found_frames.items()
    )
    notes = [
        "lengths are converted from millimetres to metres; the world's z axis still points up",
        "camera axes are converted from y up, z backwards to y down, z forward (OpenCV)",
        "intrinsics are converted from 1/64 pixels to pixels, with the origin at the first pixel's corner",
    ]
    unused = sorted(set(calibrations) - set(pairs.values()))
    if unused:
        notes.append(f"cameras without a video, not imported: {', '.join(unused)}")
    if uncalibrated:
        notes.append(f"cameras that Qualisys has not calibrated: {', '.join(uncalibrated)}")
    return Imported(cameras, tuple(notes))


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read a .qca.txt file. Returns the calibrated cameras, in metres, keyed by serial number. Raises UserError if the
    XML is invalid, or a value is missing or invalid."""
    return _read_all(path)[0]


def _read_all(path: Path) -> tuple[dict[str, Camera], list[str]]:
    """Return the calibrated cameras, and the serial numbers of the others."""
    try:
        root = ElementTree.fromstring(read_limited(path))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise UserError(f"{path}: expected Qualisys' XML, got '{error}'; export it again") from error
    cameras: dict[str, Camera] = {}
    uncalibrated: list[str] = []
    for node in root.iter("camera"):
        serial = node.get("serial", "")
        if not serial or serial in cameras or serial in uncalibrated:
            raise UserError(f"{path}: expected a unique serial number, got '{serial}'; export it again")
        if node.get("active", "1") != "1":
            continue
        if node.get("calibrated", "true").lower() in ("false", "0"):
            uncalibrated.append(serial)
        else:
            cameras[serial] = _CameraNode(path, serial, node).camera()
    if not cameras:
        got = f"only cameras without a calibration ({', '.join(uncalibrated)})" if uncalibrated else "none"
        raise UserError(f"{path}: expected <camera> entries with a calibration, got {got}; export it again")
    return cameras, uncalibrated


class _CameraNode:
    """The XML element of one camera. The error messages of this class name the camera."""

    def __init__(self, path: Path, serial: str, node: ElementTree.Element) -> None:
        self.where = f"{path}: camera '{serial}'"
        self.node = node

    def camera(self) -> Camera:
        if self.value(".", "viewrotation", 0.0) != 0:
            raise UserError(f"{self.where}: expected viewrotation 0, got another value; export without rotated views")
        left, top = self.value("fov_video", "left"), self.value("fov_video", "top")
        width = round(self.value("fov_video", "right") - left) + 1
        height = round(self.value("fov_video", "bottom") - top) + 1
        if not (1 <= width <= MAX_PIXELS and 1 <= height <= MAX_PIXELS):
            raise UserError(f"{self.where}: <fov_video>: expected a part of the sensor, got none; export it again")
        focal_x, focal_y, centre_x, centre_y, skew = (
            self.value("intrinsic", name) / SUBPIXELS
            for name in ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV", "skew")
        )
        intrinsics = np.array([[focal_x, skew, centre_x - left + 0.5], [0, focal_y, centre_y - top + 0.5], [0, 0, 1]])
        radial = [self.value("intrinsic", f"radialDistortion{i}") for i in (1, 2, 3)]
        tangential = [self.value("intrinsic", f"tangentalDistortion{i}") for i in (1, 2)]
        axes = np.array([[self.value("transform", f"r{i}{j}") for j in (1, 2, 3)] for i in (1, 2, 3)])
        centre = METRES_PER_MM * np.array([self.value("transform", axis) for axis in "xyz"])
        R_camera_world = np.diag([1.0, -1.0, -1.0]) @ axes
        distortion = np.array([*radial[:2], *tangential, radial[2]])
        try:
            return Camera(intrinsics, R_camera_world, -R_camera_world @ centre, width, height, distortion)
        except ValueError as error:
            raise UserError(f"{self.where}: {error}; calibrate that camera again") from error

    def value(self, tag: str, name: str, default: float | None = None) -> float:
        node = self.node.find(tag)
        text = None if node is None else node.get(name)
        if text is None and default is not None:
            return default
        try:
            number = float(text or "")
            if not abs(number) < MAX_VALUE:
                raise ValueError
        except ValueError as error:
            raise UserError(
                f"{self.where}: <{tag} {name}>: expected a finite number, got '{(text or 'nothing')[:MAX_SHOWN]}'; "
                "export it again"
            ) from error
        return number


def _find_file(source: Path) -> Path | None:
    if source.is_file():
        return source if source.name.endswith(SUFFIX) else None
    return next(iter(sorted(source.glob(f"*{SUFFIX}"))), None)
