"""Clean plates (images of the empty scene), from which the background's points are computed. The user provides them, or
``fourd matte`` makes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError, command_line
from fourd.base.progress import Log
from fourd.recording.capture import Capture, open_capture, read_calibration
from fourd.recording.capture.camera_frames import Footage, Mattes
from fourd.recording.capture.decoding import decode_alpha, decode_picture
from fourd.recording.capture.layout import find_pictures
from fourd.recording.matting.plates import FOLDER
from fourd.recording.stereo.view import StereoView

Picture = NDArray[np.uint8]

USER_FOLDER = "bgs"
"""Subfolder of a capture's folder in which the user provides plates. The plate of the camera CAM is CAM.png or CAM.jpg,
and has the same lens distortion as the frames."""
MIN_SEEN_SHARE = 0.5
MIN_CAMERAS = 2


@dataclass(frozen=True, eq=False)
class PlateView(StereoView):
    """Image of the background as one camera sees it without the subject. Where the plate does not show the background,
    ``seen`` is false."""


def has_plate(path: Path, name: str) -> bool:
    """Return true if a capture's folder contains a clean plate of a camera, which may come from the user or from
    fourd."""
    return name in find_pictures(path / USER_FOLDER) or (path / FOLDER / f"{name}.png").exists()


def read_plates(
    capture: Capture, cameras: Sequence[int], log: Log = lambda line: None, made: Path | None = None
) -> tuple[PlateView, ...]:
    """Read the plates of some cameras of a capture. The function removes the lens distortion of the user's plates, and
    resizes all plates to match ``capture.cameras``.

    For each camera, the user's plate ``bgs/CAM.png`` or ``bgs/CAM.jpg`` is used if it exists. It must have the full
    size and the lens distortion of the frames, and its pixels that are not opaque are holes. Otherwise, the plate
    ``.fourd/plates/CAM.png`` from :mod:`fourd.recording.matting.plates` is read.

    Args:
        capture: the capture.
        cameras: indices of at least two cameras.
        log: reports plates that are mostly holes.
        made: folder with plates that fourd made; if None, ``.fourd/plates`` in the capture's folder is used.

    Returns:
        one view per camera, in the order of ``cameras``.

    Raises:
        UserError: if a camera has no plate, a file is unreadable or has the wrong size, or fewer than two plates show
            background.
    """
    files = _files(capture, [capture.names[index] for index in cameras], made or capture.path / FOLDER)
    lenses = _lenses(capture, list(files))
    views = tuple(
        _view(capture, capture.names[index], capture.cameras[index], lenses, files[capture.names[index]])
        for index in cameras
    )
    shares = {view.name: float(view.seen.mean()) for view in views}
    seeing = sum(share > 0 for share in shares.values())
    if seeing < MIN_CAMERAS:
        raise UserError(
            f"{capture.path}: expected clean plates of at least {MIN_CAMERAS} cameras that show background, got "
            f"{seeing}; use more cameras, or add images of the empty scene as {USER_FOLDER}/CAM.png"
        )
    poor = [name for name, share in shares.items() if share < MIN_SEEN_SHARE]
    if poor:
        log(
            f"{capture.path}: more than half of the clean plate of {', '.join(poor)} is a hole, because the subject "
            f"covers this area in every frame; add an image of the empty scene as {USER_FOLDER}/CAM.png"
        )
    return views


@dataclass(frozen=True)
class _File:
    """Path of a plate. ``made`` is true if fourd made the plate, and false if the user provided it. Plates that fourd
    made have no lens distortion. The user's plates have the same lens distortion as the frames."""

    path: Path
    made: bool


def _files(capture: Capture, names: Sequence[str], folder: Path) -> dict[str, _File]:
    """Find the plate file of each camera, by camera name."""
    provided = find_pictures(capture.path / USER_FOLDER)
    files = {}
    for name in names:
        made = folder / f"{name}.png"
        if name in provided:
            files[name] = _File(capture.path / USER_FOLDER / provided[name], False)
        elif made.exists():
            files[name] = _File(made, True)
    missing = [name for name in names if name not in files]
    if missing:
        rest = len(missing) - 1
        more = f" (and of {rest} more camera{'s' * (rest > 1)})" if rest else ""
        raise UserError(
            f"{folder / missing[0]}.png: expected the clean plate of camera '{missing[0]}'{more}, got no such file "
            f"here or in {USER_FOLDER}; make clean plates: {command_line('fourd', 'matte', capture.path)}"
        )
    return files


def _lenses(capture: Capture, names: list[str]) -> dict[str, Camera]:
    """Return a dictionary from each of the ``names`` to its camera, which has lens distortion and the full size of the
    frames."""
    calibrations = read_calibration(capture.path)
    with open_capture(capture.path, views=names, frames="0:1", mattes=False) as whole:
        return {
            name: replace(camera, distortion=calibrations[name].distortion)
            for name, camera in zip(whole.names, whole.cameras, strict=True)
        }


@dataclass(frozen=True, eq=False)
class _Still:
    """An image in memory that the frame reader can read as a video with one frame."""

    path: Path
    picture: Picture

    def read(self, frame: int) -> Picture:
        return self.picture

    def describe(self, frame: int) -> str:
        return str(self.path)

    def close(self) -> None:
        """Do nothing: the image is in memory."""


def _view(capture: Capture, name: str, camera: Camera, lenses: dict[str, Camera], file: _File) -> PlateView:
    lens = lenses[name]
    # Colours in the holes of a plate are used: they are estimates.
    rgb, opaque = decode_picture(file.path)[..., :3], decode_alpha(file.path)
    height, width = opaque.shape
    if (width, height) != (lens.width, lens.height):
        again = "export the plate again at the size of the frames"
        fix = f"remove this plate and run: {command_line('fourd', 'matte', capture.path)}" if file.made else again
        raise UserError(
            f"{file.path}: expected {lens.width} x {lens.height} pixels like the frames of camera '{name}', "
            f"got {width} x {height}; {fix}"
        )
    if file.made:
        # In plates that fourd made, pixels outside the lens's field of view are black and opaque. Undistorting a fully
        # opaque matte of the same camera shows where these pixels are: the result is transparent there.
        seen = np.minimum(opaque, _undistort(capture, name, lens, file.path, rgb, np.full_like(opaque, 255))[1])
    else:
        rgb, seen = _undistort(capture, name, lens, file.path, rgb, opaque)
    if (camera.width, camera.height) != (width, height):
        how = cv2.INTER_AREA if camera.width < width else cv2.INTER_LINEAR
        rgb, seen = (
            np.asarray(cv2.resize(part, (camera.width, camera.height), interpolation=how), np.uint8)
            for part in (rgb, seen)
        )
    return PlateView(name, camera, rgb, seen == 255)


def _undistort(
    capture: Capture, name: str, lens: Camera, path: Path, rgb: Picture, matte: Picture
) -> tuple[Picture, Picture]:
    """Undistort a plate and its opacity mask ``matte``, with the code that also undistorts the capture's frames and
    mattes."""
    footage = Footage(_Still(path, rgb), Mattes(_Still(path, matte), is_generated=False), (lens.width, lens.height))
    alone = Capture(capture.path, [name], [lens], [footage], ["plate"], [0], 1, scale=1.0, cache_mb=0)
    return alone.image(0, 0), alone.mask(0, 0)
