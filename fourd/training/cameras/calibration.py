"""A run's own calibration: adjusted before carving, corrected while training, and written back as files.

``RUN/calibration/start/`` has the cameras that the run begins with, ``RUN/calibration/`` the newest ones: intri.yml and
extri.yml of every camera of the capture, and colours.json where colours are corrected.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.background.shell import viewing_centre
from fourd.bundle_adjustment.adjust import adjust_cameras
from fourd.bundle_adjustment.solver import Prior
from fourd.cameras import Camera
from fourd.capture import Capture, read_calibration, write_calibration
from fourd.capture.calibration import INTRINSICS_NAME
from fourd.errors import UserError
from fourd.files import write_text_atomically
from fourd.progress import Log, Track
from fourd.training.cameras.rig import Rig
from fourd.training.config import RefineConfig

CALIBRATION = "calibration"
START = "start"
COLOURS = "colours.json"
TILT = 12
"""Where in OpenCV's 14 coefficients of distortion the sensor's tilt begins."""
POWERS = (2, 4, 1, 1, 6, 2, 4, 6, 1, 3, 1, 3)
"""Of a zoom, by which each coefficient of distortion grows with it."""


def adjust_run(
    capture: Capture, training: list[int], folder: Path, config: RefineConfig, track: Track, log: Log
) -> None:
    """Write the calibration that a run begins with, from what its training views share; keeps one that is there.

    Held-out views have no say and stay as given.
    """
    target = folder / CALIBRATION / START
    if (target / INTRINSICS_NAME).exists():
        return
    if config.focal:
        _require_no_tilt(capture)
    given = [capture.cameras[index] for index in training]
    focus = viewing_centre(given)
    distance = np.array([float(np.linalg.norm(camera.centre - focus)) for camera in given])
    prior = Prior(
        np.radians(config.rotation_deg) if config.poses else 0.0,
        config.position * distance if config.poses else np.zeros(len(given)),
        config.focal_spread if config.focal else 0.0,
    )
    found = adjust_cameras(capture, training, prior, config.band, track)
    names = [capture.names[index] for index in training]
    few = [name for name, features in zip(names, found.features, strict=True) if not features]
    if len(few) < len(names):
        log(
            f"cameras: {int(found.features.sum())} features agree to {found.after_px:.2f} px, "
            f"before to {found.before_px:.2f} px (medians)"
        )
    if few:
        rest = "all cameras" if len(few) == len(names) else f"cameras {', '.join(few)}"
        log(f"cameras: too few features that others show too; {rest} begin as given")
    cameras = list(capture.cameras)
    for index, camera in zip(training, found.cameras, strict=True):
        cameras[index] = camera
    write_corrected(folder, capture, Rig(tuple(cameras)), START)


def begun_with(capture: Capture, folder: Path) -> Capture:
    """The capture with the cameras that the run in ``folder`` begins with. Raises UserError where these are missing."""
    start = folder / CALIBRATION / START
    if not (start / INTRINSICS_NAME).exists():
        raise UserError(f"{start}: expected the cameras that the run begins with, got none; train in a new folder")
    calibrations = read_calibration(start)
    cameras = []
    for name, lens, camera in zip(capture.names, capture.distorted_cameras, capture.cameras, strict=True):
        if name not in calibrations:
            raise UserError(f"{start}: expected camera '{name}' of the capture, got none; train in a new folder")
        whole = replace(calibrations[name].camera(lens.width, lens.height), distortion=None)
        cameras.append(whole.resize(camera.width, camera.height))
    return capture.with_cameras(cameras)


def write_corrected(folder: Path, capture: Capture, rig: Rig, below: str = "") -> None:
    """Write the calibration of ``rig``'s cameras, which are the capture's, and of its others as they are."""
    target = folder / CALIBRATION / below
    corrected = {
        name: _lens(lens, camera)
        for name, lens, camera in zip(capture.names, capture.distorted_cameras, rig.cameras, strict=True)
    }
    others = {
        name: each.camera(each.width or 1, each.height or 1)
        for name, each in read_calibration(capture.path).items()
        if name not in corrected and each.width and each.height
    }
    cameras = {**others, **corrected}
    names = [name for name in read_calibration(capture.path) if name in cameras]
    write_calibration(target, names, [cameras[name] for name in names])
    if rig.colours is not None:
        content = {
            name: {"matrix": colours[:, :3].tolist(), "offset": colours[:, 3].tolist()}
            for name, colours in zip(capture.names, rig.colours, strict=True)
        }
        write_text_atomically(target / COLOURS, json.dumps(content, indent=1) + "\n")


def _lens(lens: Camera, camera: Camera) -> Camera:
    """``lens`` with the pose and focal length of ``camera``; pictures that lose its distortion stay as they are."""
    whole = camera.resize(lens.width, lens.height)
    zoom = whole.intrinsics[1, 1] / lens.intrinsics[1, 1]
    distortion = None if lens.distortion is None else zoomed_distortion(lens.distortion, zoom)
    return replace(whole, distortion=distortion)


def zoomed_distortion(distortion: NDArray[np.float64], zoom: float) -> NDArray[np.float64]:
    """OpenCV's coefficients for a focal length ``zoom`` times as long that move the same pixels to the same places.

    A sensor's tilt is left as it is, which is right for a zoom of 1 alone.
    """
    powers = np.array([*POWERS, 0, 0])[: len(distortion)]
    return distortion * zoom**powers


def _require_no_tilt(capture: Capture) -> None:
    for name, lens in zip(capture.names, capture.distorted_cameras, strict=True):
        if lens.distortion is not None and lens.distortion[TILT:].any():
            raise UserError(
                f"{capture.path / INTRINSICS_NAME}: D_{name}: expected a sensor without tilt to refine focal lengths, "
                f"got {lens.distortion[TILT:].tolist()}; set refine.focal: false"
            )
