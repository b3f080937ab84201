"""Clean plates as background seeding reads them: the user's own or those that ``fourd matte`` made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.capture import Capture, open_capture, read_calibration
from fourd.capture.decoding import decode_alpha, decode_rgb
from fourd.capture.layout import find_pictures
from fourd.capture.reader import Footage, Mattes
from fourd.errors import UserError
from fourd.matting.plates import FOLDER
from fourd.progress import Log

Picture = NDArray[np.uint8]

USERS = "bgs"
"""Folder of a capture for plates that the user brings, CAM.png or .jpg, with the lens's distortion as the pictures."""
MOSTLY_SEEN = 0.5
LEAST_CAMERAS = 2


@dataclass(frozen=True, eq=False)
class PlateView:
    """One camera's background without the subject.

    Attributes:
        name: the camera's.
        camera: undistorted pinhole of the picture.
        rgb: (H, W, 3) uint8; what it has in holes means nothing.
        seen: (H, W) bool, False in holes and where the lens did not see.
    """

    name: str
    camera: Camera
    rgb: Picture
    seen: NDArray[np.bool_]


def has_plate(path: Path, name: str) -> bool:
    """Whether a capture's folder has a clean plate of a camera, brought or made."""
    return name in find_pictures(path / USERS) or (path / FOLDER / f"{name}.png").exists()


def read_plates(
    capture: Capture, cameras: Sequence[int], log: Log = lambda line: None, made: Path | None = None
) -> tuple[PlateView, ...]:
    """The plates of some of a capture's cameras, undistorted and scaled as ``capture.cameras`` describe them.

    ``bgs/CAM.png`` or ``.jpg`` of the user comes first: of the pictures' full size and, like them, with the lens's
    distortion; what is not opaque is a hole. Else ``.fourd/plates/CAM.png``, as fourd.matting.plates writes it.

    Args:
        cameras: indices of the cameras, at least two.
        say: told which plates are mostly holes.
        made: folder of plates as fourd makes them, in place of the capture's ``.fourd/plates``.

    Returns:
        one view for each of ``cameras``, in their order.

    Raises:
        UserError: one line, where a camera has no plate, a file cannot be read or is of another size, and where
            fewer than two of the cameras see background.
    """
    files = _files(capture, [capture.names[index] for index in cameras], made or capture.path / FOLDER)
    lenses = _lenses(capture, list(files))
    views = tuple(
        _view(capture, capture.names[index], capture.cameras[index], lenses, files[capture.names[index]])
        for index in cameras
    )
    shares = {view.name: float(view.seen.mean()) for view in views}
    seeing = sum(share > 0 for share in shares.values())
    if seeing < LEAST_CAMERAS:
        raise UserError(
            f"{capture.path}: expected clean plates of at least {LEAST_CAMERAS} cameras that show background, got "
            f"{seeing}; use more cameras, or bring pictures of the empty stage as {USERS}/CAM.png"
        )
    poor = [name for name, share in shares.items() if share < MOSTLY_SEEN]
    if poor:
        log(
            f"{capture.path}: more than half of the clean plate of {', '.join(poor)} is hole, since the subject is "
            f"always there; a picture of the empty stage as {USERS}/CAM.png would help"
        )
    return views


@dataclass(frozen=True)
class _File:
    """Where a plate lies, and whether fourd made it: then it is undistorted."""

    path: Path
    made: bool


def _files(capture: Capture, names: Sequence[str], folder: Path) -> dict[str, _File]:
    """Each camera's plate."""
    brought = find_pictures(capture.path / USERS)
    files = {}
    for name in names:
        made = folder / f"{name}.png"
        if name in brought:
            files[name] = _File(capture.path / USERS / brought[name], False)
        elif made.exists():
            files[name] = _File(made, True)
    missing = [name for name in names if name not in files]
    if missing:
        more = f" (and of {len(missing) - 1} more cameras)" if len(missing) > 1 else ""
        raise UserError(
            f"{folder / missing[0]}.png: expected the clean plate of camera '{missing[0]}', got none "
            f"there or in {USERS}{more}; make them: fourd matte {capture.path}"
        )
    return files


def _lenses(capture: Capture, names: list[str]) -> dict[str, Camera]:
    """The cameras with their distortion, at the pictures' full size."""
    whole = open_capture(capture.path, views=names, frames="0:1", mattes=False)
    calibrations = read_calibration(capture.path)
    return {
        name: replace(camera, distortion=calibrations[name].distortion)
        for name, camera in zip(whole.names, whole.cameras, strict=True)
    }


@dataclass(frozen=True, eq=False)
class _Still:
    """A picture in memory that stands for a camera's only frame."""

    path: Path
    picture: Picture

    def read(self, frame: int) -> Picture:
        return self.picture

    def describe(self, frame: int) -> str:
        return str(self.path)


def _view(capture: Capture, name: str, camera: Camera, lenses: dict[str, Camera], file: _File) -> PlateView:
    lens = lenses[name]
    rgb, opaque = decode_rgb(file.path), decode_alpha(file.path)
    height, width = opaque.shape
    if (width, height) != (lens.width, lens.height):
        mend = f"remove it and run: fourd matte {capture.path}" if file.made else "export it again at that size"
        raise UserError(
            f"{file.path}: expected {lens.width} x {lens.height} pixels, as the pictures of camera '{name}' have, "
            f"got {width} x {height}; {mend}"
        )
    if file.made:
        # What the lens did not see is black in plates that fourd made, and opaque.
        seen = np.minimum(opaque, _as_read(capture, name, lens, file.path, rgb, np.full_like(opaque, 255))[1])
    else:
        rgb, seen = _as_read(capture, name, lens, file.path, rgb, opaque)
    if (camera.width, camera.height) != (width, height):
        how = cv2.INTER_AREA if camera.width < width else cv2.INTER_LINEAR
        rgb, seen = (
            np.asarray(cv2.resize(part, (camera.width, camera.height), interpolation=how), np.uint8)
            for part in (rgb, seen)
        )
    return PlateView(name, camera, rgb, seen == 255)


def _as_read(
    capture: Capture, name: str, lens: Camera, path: Path, rgb: Picture, matte: Picture
) -> tuple[Picture, Picture]:
    """A plate and a matte with the lens's distortion taken out as the capture takes it out of its frames."""
    footage = Footage(_Still(path, rgb), Mattes(_Still(path, matte), is_generated=False), (lens.width, lens.height))
    alone = Capture(capture.path, [name], [lens], [footage], ["plate"], [0], 1, scale=1.0, cache_mb=0)
    return alone.image(0, 0), alone.mask(0, 0)
