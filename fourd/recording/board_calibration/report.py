"""Quality of a rig's calibration: errors, coverage of the images, and values that are badly determined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.board_calibration.adjustment.rig import LENS, POSE, Timing
from fourd.recording.board_calibration.fit import RigFit
from fourd.recording.board_calibration.initial import CameraPair

Array = NDArray[np.float64]

CELLS = (8, 6)
"""Columns and rows of the cells into which an image is divided for its coverage."""
FEW_VIEWS = 15
LOW_COVERAGE = 0.5
MIN_TILT_DEGREES = 20.0
"""In at least a tenth of the views, the board should be tilted against the image plane by more than this angle, because
in frontal views a longer focal length looks almost the same as a smaller distance."""
MAX_FOCAL_STD = 0.005
"""Maximum standard deviation of the focal length without a warning, as a fraction of the focal length."""
MAX_CENTRE_STD_DEGREES = 0.3
"""Maximum standard deviation of the viewing direction without a warning.

It is computed as the standard deviation of the principal point divided by the focal length, and converted to degrees.
"""
MAX_ROTATION_STD_DEGREES = 0.2
FEW_SHARED_FRAMES = 10
HELD_OUT_RATIO = 1.5
"""A warning is reported if the error on held-out frames exceeds this multiple of the error in the fit by more than 0.1
px."""


@dataclass(frozen=True)
class CameraReport:
    """Quality of one camera's calibration.

    Attributes:
        name: the camera's name.
        views: number of frames in which the camera sees the board.
        corners: number of detected corners in all these frames.
        fit_px: root mean square error on the frames of the fit, in pixels.
        held_out_px: root mean square error on held-out frames, in pixels, or None if there are no held-out frames.
        median_px: median error over all frames, in pixels.
        coverage: fraction of the image's cells in which corners were seen.
        max_tilt_degrees: 90th percentile of the angle between the board's normal and the viewing direction.
        focal_px: focal lengths fx and fy.
        focal_std: standard deviation of fx as a fraction of fx; 0 for a known lens.
        centre_std_px: standard deviations of the principal point; 0 for a known lens.
        rotation_std_degrees: standard deviation of the orientation relative to the first camera.
        position_std_m: standard deviation of the position relative to the first camera.
        estimated: whether the lens was estimated.
        warnings: one line for each value that is badly determined.
    """

    name: str
    views: int
    corners: int
    fit_px: float
    held_out_px: float | None
    median_px: float
    coverage: float
    max_tilt_degrees: float
    focal_px: tuple[float, float]
    focal_std: float
    centre_std_px: tuple[float, float]
    rotation_std_degrees: float
    position_std_m: float
    estimated: bool
    warnings: tuple[str, ...]

    def line(self) -> str:
        """Format the report as one line."""
        kept = "no held-out frames" if self.held_out_px is None else f"{self.held_out_px:.2f} px on held-out frames"
        return (
            f"{self.name}: {self.fit_px:.2f} px rms, {kept}; {self.corners} corners in {self.views} frames cover "
            f"{self.coverage:.0%} of the image; focal length {self.focal_px[0]:.1f} px"
            + (f" +- {100 * self.focal_std:.2f}%" if self.estimated else " (given)")
        )


def report_cameras(fit: RigFit, names: Sequence[str]) -> list[CameraReport]:
    """Measure the quality of each camera's calibration."""
    return [_report_camera(fit, index, name) for index, name in enumerate(names)]


def report_content(
    fit: RigFit, names: Sequence[str], cameras: Sequence[CameraReport], fps: float | None
) -> dict[str, Any]:
    """Return the content of report.json, apart from the board and the settings.

    ``fps`` is the rate of the frames, if it is known.
    """
    kept = [frame for frame, out in zip(fit.frames, fit.held_out, strict=True) if out]
    return {
        "cameras": {camera.name: _rounded(camera) for camera in cameras},
        "pairs": [
            {
                "cameras": [names[pair.first], names[pair.second]],
                "frames": pair.frames,
                "baseline_m": _baseline(fit, pair),
            }
            for pair in fit.pairs
        ],
        "frames": {"fit": len(fit.frames) - len(kept), "held_out": kept},
        "timing": None if fit.timing is None else _timing_content(fit.timing, names, fps),
        "board_thickness_m": round(fit.thickness_m, 5),
    }


def time_lines(fit: RigFit, names: Sequence[str], fps: float | None) -> list[str]:
    """Return the estimated delays and readouts of the cameras, and the estimated thickness of the board, one line
    each."""
    lines = []
    if fit.timing is not None:
        unit, factor = ("frames", 1.0) if fps is None else ("ms", 1000 / fps)
        digits = 2 if fps is None else 0
        for name, delay, readout in zip(names, fit.timing.delay, fit.timing.readout, strict=True):
            when = f"lags {names[0]} by {factor * delay:.{digits}f} {unit}" if name != names[0] else "gives the time"
            lines.append(f"{name} {when}; its rows are read within {abs(factor * readout):.{digits}f} {unit}")
    if fit.thickness_m:
        lines.append(f"the back of the board lies {1e3 * fit.thickness_m:.1f} mm behind its front")
    return lines


def _timing_content(timing: Timing, names: Sequence[str], fps: float | None) -> dict[str, Any]:
    """Return the delays and readouts by camera."""
    content = {}
    for name, delay, readout in zip(names, timing.delay.tolist(), timing.readout.tolist(), strict=True):
        content[name] = {"delay_frames": round(delay, 4), "readout_frames": round(readout, 4)}
        if fps is not None:
            content[name] |= {"delay_ms": round(1000 * delay / fps, 2), "readout_ms": round(1000 * readout / fps, 2)}
    return content


def coverage(pixels: Array, width: int, height: int) -> float:
    """Return the fraction of the image's 8 x 6 cells that contain at least one of the pixels (N, 2)."""
    cells = np.floor(pixels / (width, height) * CELLS).astype(int)
    inside = ((cells >= 0) & (cells < CELLS)).all(axis=1)
    return len(np.unique(cells[inside], axis=0)) / (CELLS[0] * CELLS[1])


def _report_camera(fit: RigFit, index: int, name: str) -> CameraReport:
    rows = fit.corners.camera == index
    camera, std = fit.cameras[index], fit.std[index]
    boards = np.unique(fit.corners.board[rows])
    focal = float(camera.intrinsics[0, 0]), float(camera.intrinsics[1, 1])
    tilts = _tilts(fit, camera, boards)
    report = CameraReport(
        name,
        len(boards),
        int(rows.sum()),
        fit.rms(index, False) or 0.0,
        fit.rms(index, True),
        float(np.median(fit.errors[rows])),
        coverage(fit.corners.pixels[rows], camera.width, camera.height),
        float(np.percentile(tilts, 90)),
        focal,
        float(std[LENS][0] / focal[0]),
        (float(std[LENS][2]), float(std[LENS][3])),
        float(np.degrees(np.linalg.norm(std[POSE][:3]))),
        float(np.linalg.norm(std[POSE][3:])),
        bool(fit.estimated[index]),
        (),
    )
    shared = [pair.frames for pair in fit.pairs if index in (pair.first, pair.second)]
    return replace(report, warnings=tuple(_warnings(report, shared)))


def _warnings(report: CameraReport, shared: Sequence[int]) -> list[str]:
    found = []
    if report.estimated:
        if report.views < FEW_VIEWS:
            found.append(f"only {report.views} views of the board; film at least {FEW_VIEWS} for an unknown lens")
        if report.coverage < LOW_COVERAGE:
            found.append(
                f"corners cover {report.coverage:.0%} of the image, so the distortion elsewhere is extrapolated; hold "
                "the board in every part of the image, also the corners"
            )
        if report.max_tilt_degrees < MIN_TILT_DEGREES:
            found.append(
                f"the board is always frontal (at most {report.max_tilt_degrees:.0f} degrees), which leaves the focal "
                "length uncertain; tilt the board by 30 to 45 degrees in all directions"
            )
        if report.focal_std > MAX_FOCAL_STD:
            found.append(
                f"the focal length is uncertain by {report.focal_std:.1%}; hold the board closer and more tilted"
            )
        direction = float(np.degrees(max(report.centre_std_px) / report.focal_px[0]))
        if direction > MAX_CENTRE_STD_DEGREES:
            found.append(
                f"the principal point is uncertain by {max(report.centre_std_px):.0f} px, and therefore the "
                f"orientation by {direction:.1f} degrees; film the board closer and tilted, or give a known lens by "
                "--intrinsics"
            )
    if report.rotation_std_degrees > MAX_ROTATION_STD_DEGREES:
        found.append(f"the orientation is uncertain by {report.rotation_std_degrees:.1f} degrees; film more frames")
    if shared and max(shared) < FEW_SHARED_FRAMES:
        found.append(f"at most {max(shared)} frames are shared with another camera; film the board where both see it")
    if report.held_out_px is not None and report.held_out_px > HELD_OUT_RATIO * report.fit_px + 0.1:
        found.append(
            f"the error is {report.held_out_px:.2f} px on held-out frames and {report.fit_px:.2f} px in the fit; film "
            "more frames"
        )
    return [f"{report.name}: {line}" for line in found]


def _tilts(fit: RigFit, camera: Camera, boards: NDArray[np.intp]) -> Array:
    """Return the angles (M,) in degrees between the board's normal and the camera's viewing direction."""
    normals = fit.boards.rotation[boards][:, :, 2]
    return np.degrees(np.arccos(np.clip(np.abs(normals @ camera.forward), 0, 1)))


def _baseline(fit: RigFit, pair: CameraPair) -> float:
    return round(float(np.linalg.norm(fit.cameras[pair.first].centre - fit.cameras[pair.second].centre)), 5)


def _rounded(camera: CameraReport) -> dict[str, Any]:
    """Return the report as JSON values, rounded to five decimals."""

    def convert(value: Any) -> Any:
        if isinstance(value, tuple):
            return [convert(each) for each in value]
        return round(float(value), 5) if isinstance(value, float) else value

    return {key: convert(value) for key, value in asdict(camera).items() if key != "name"}
