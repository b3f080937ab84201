"""Files that store the calibration of a run.

``RUN/calibration/start/`` contains the cameras with which training starts. ``RUN/calibration/`` contains the newest
cameras. Each folder has intri.yml and extri.yml with all cameras of the capture. If colours are corrected, each folder
also has colours.json.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.reconstruction.training.run_layout import CALIBRATION, START
from fourd.recording.capture import Capture, read_calibration, write_calibration
from fourd.recording.capture.calibration import require_calibration
from fourd.recording.capture.layout import INTRINSICS_NAME

if TYPE_CHECKING:
    from fourd.reconstruction.training.cameras.rig import Rig

COLOURS = "colours.json"
POWERS = (2, 4, 1, 1, 6, 2, 4, 6, 1, 3, 1, 3)
"""Exponents for scaling OpenCV's distortion coefficients: if the focal length is multiplied by z, the i-th coefficient
is multiplied by ``z**POWERS[i]``."""


def with_start_cameras(capture: Capture, folder: Path) -> Capture:
    """Replace the capture's cameras by the start cameras of the run in ``folder``. Raises UserError if the run has no
    start camera for one of them."""
    start = folder / CALIBRATION / START
    if not (start / INTRINSICS_NAME).exists():
        raise UserError(f"{start}: expected the start cameras of the run, got no file; train in a new folder")
    calibrations = read_calibration(start)
    cameras = []
    for name, lens, camera in zip(capture.names, capture.distorted_cameras, capture.cameras, strict=True):
        if name not in calibrations:
            raise UserError(f"{start}: expected the capture's camera '{name}', got none; train in a new folder")
        whole = replace(calibrations[name].camera(lens.width, lens.height), distortion=None)
        cameras.append(whole.resize(camera.width, camera.height))
    return capture.with_cameras(cameras)


def write_corrected(folder: Path, capture: Capture, rig: Rig, below: str = "") -> None:
    """Write the calibration with the corrected cameras of ``rig``. Cameras that the run does not use are written
    unchanged.

    Args:
        folder: folder of the run.
        capture: the selected part of the capture, with its cameras in the order of ``rig.cameras``.
        rig: the corrected cameras and colours.
        below: name of the subfolder of ``calibration/`` to write to. An empty name selects ``calibration/`` itself.
    """
    target = folder / CALIBRATION / below
    corrected = {
        name: _lens(lens, camera)
        for name, lens, camera in zip(capture.names, capture.distorted_cameras, rig.cameras, strict=True)
    }
    given = require_calibration(capture.path)
    others = {
        name: each.camera(each.width or 1, each.height or 1)
        for name, each in given.calibrations.items()
        if name not in corrected and each.width and each.height
    }
    cameras = {**others, **corrected}
    names = [name for name in given.calibrations if name in cameras]
    write_calibration(target, names, [cameras[name] for name in names], given.metres_per_unit)
    if rig.colours is not None:
        content = {
            name: {"matrix": colours[:, :3].tolist(), "offset": colours[:, 3].tolist()}
            for name, colours in zip(capture.names, rig.colours, strict=True)
        }
        write_text_atomically(target / COLOURS, json.dumps(content, indent=1) + "\n")


def _lens(lens: Camera, camera: Camera) -> Camera:
    """Return the distorted camera ``lens`` with the pose and the focal length of ``camera``. The distortion
    coefficients are scaled to the new focal length, so that undistorting an image gives the same result as with
    ``lens``."""
    whole = camera.resize(lens.width, lens.height)
    zoom = whole.intrinsics[1, 1] / lens.intrinsics[1, 1]
    distortion = None if lens.distortion is None else zoomed_distortion(lens.distortion, zoom)
    return replace(whole, distortion=distortion)


def zoomed_distortion(distortion: NDArray[np.float64], zoom: float) -> NDArray[np.float64]:
    """Adapt OpenCV's distortion coefficients to a focal length that is multiplied by ``zoom``, so that they displace
    each pixel by the same amount as before.

    The coefficients of sensor tilt are not scaled, so for lenses with sensor tilt, the result is exact only if ``zoom``
    is 1.
    """
    powers = np.array([*POWERS, 0, 0])[: len(distortion)]
    return distortion * zoom**powers
