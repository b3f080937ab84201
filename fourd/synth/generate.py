"""Generation of a synthetic capture: cameras, images, mattes, true depth, true clean plates (images without the figure)
and settings."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from fourd.cameras import Camera, look_at
from fourd.capture.calibration import write_calibration
from fourd.capture.frame_rate import DEFAULT_FPS, check_rate, standard_rate, write_rate
from fourd.errors import UserError
from fourd.files import write_bytes_atomically, write_text_atomically
from fourd.limits import read_json
from fourd.progress import Terminal
from fourd.synth.figure import Figure, make_figure, pose_figure
from fourd.synth.render import RenderedFigure, projected_extent, render_figure, render_plate

Array = NDArray[np.float64]

SETTINGS_NAME = "synth.json"
VERSION = 1
CYCLE_FRAMES = 24
RING_RADIUS = 3.6
RING_HEIGHTS = (1.35, 0.75, 2.15)
FILL = 0.9
"""Maximum extent of the figure in any image over a whole gait cycle, as a fraction of the image's side length."""


@dataclass(frozen=True)
class SynthSettings:
    """Settings of a synthetic capture, which determine every byte of it.

    Attributes:
        frames: number of frames, at least 1. They cover a whole number of gait cycles of about 24 frames each, so the
            capture can be played in a loop.
        cameras: number of cameras, 3 to 100. They are evenly spaced on a ring with a radius of 3.6 m, at three
            different heights.
        size: width and height of the images, 32 to 4096 pixels.
        seed: seed of all random numbers, at least 0. It determines the clothes, the proportions and the gait phase in
            frame 0.
        gloss: strength of the highlights, 0 to 1.
        fps: frame rate of the capture in frames per second, 0.01 to 1000. It does not change the images.

    Raises:
        UserError: if a value is out of range. The error message contains the name of the option.
    """

    frames: int = 24
    cameras: int = 12
    size: int = 256
    seed: int = 0
    gloss: float = 0.3
    fps: float = DEFAULT_FPS

    def __post_init__(self) -> None:
        limits = {"frames": (1, 100_000), "cameras": (3, 100), "size": (32, 4096), "seed": (0, 2**63), "gloss": (0, 1)}
        check_rate(self.fps)
        for name, (minimum, maximum) in limits.items():
            value = getattr(self, name)
            if not minimum <= value <= maximum:
                raise UserError(f"--{name}: expected {minimum} to {maximum}, got {value}; give a number in that range")


def make_synthetic(
    out: Path | str,
    *,
    frames: int = 24,
    cameras: int = 12,
    size: int = 256,
    seed: int = 0,
    gloss: float = 0.3,
    fps: float = DEFAULT_FPS,
) -> None:
    """Write a synthetic capture of a running figure into the folder ``out``.

    The capture contains images/CAM/FRAME.jpg, masks/CAM/FRAME.png (soft mattes, 255 = figure), intri.yml, extri.yml,
    truth/depth/CAM/FRAME.png (uint16 camera depth in millimetres at pixel centres, 0 = background), truth/bgs/CAM.png
    (the empty studio) and synth.json (the settings). World units are metres, and +z points up. The same settings give
    bit-identical files. A finished synthetic capture in ``out`` is kept if it has the same settings, and is replaced if
    it has other settings.

    Args:
        out: folder that does not exist, is empty, or contains a synthetic capture.
        frames: number of frames; see :class:`SynthSettings`.
        cameras: number of cameras.
        size: width and height of the images in pixels.
        seed: seed of all random numbers.
        gloss: strength of the highlights.
        fps: frame rate in frames per second, which is stored in capture.json.

    Raises:
        UserError: if a number is out of range, or if ``out`` contains files but no synthetic capture.
    """
    out = Path(out)
    settings = SynthSettings(frames, cameras, size, seed, gloss, fps)
    if is_finished(out, settings):
        return
    _prepare_folder(out)
    _write_settings(out, settings, finished=False)
    figure = make_figure(seed)
    ring = _make_cameras(figure, settings)
    names = [f"{index:02d}" for index in range(cameras)]
    write_calibration(out, names, ring)
    write_rate(out, standard_rate(fps))
    workers = min(4, os.cpu_count() or 1, cameras)
    with _progress() as progress, ThreadPoolExecutor(workers) as pool:
        task = progress.add_task("synth", total=frames * cameras)
        jobs = [
            pool.submit(_write_camera, out, name, camera, figure, settings, lambda: progress.advance(task))
            for name, camera in zip(names, ring, strict=True)
        ]
        try:
            for job in jobs:
                job.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    _write_settings(out, settings, finished=True)


def is_finished(out: Path | str, settings: SynthSettings) -> bool:
    """Return whether ``out`` contains a finished capture with these settings."""
    return read_settings(Path(out)) == {"version": VERSION, **asdict(settings), "finished": True}


def read_settings(out: Path) -> dict[str, object] | None:
    """Read the content of synth.json. Returns None if the file is missing or invalid."""
    try:
        content = read_json(out / SETTINGS_NAME)
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) and "version" in content else None


def _write_settings(out: Path, settings: SynthSettings, *, finished: bool) -> None:
    content = {"version": VERSION, **asdict(settings), "finished": finished}
    write_text_atomically(out / SETTINGS_NAME, json.dumps(content, indent=1) + "\n")


def _prepare_folder(out: Path) -> None:
    """Create the folder ``out``. An older synthetic capture is removed, so that its frames do not mix with the new
    frames."""
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: expected a folder, got a file; name another folder")
    if out.is_dir() and any(out.iterdir()) and read_settings(out) is None:
        raise UserError(
            f"{out}: expected an empty folder or a synthetic capture ({SETTINGS_NAME}), got other files; "
            "name another folder"
        )
    out.mkdir(parents=True, exist_ok=True)
    for name in ("images", "masks", "truth"):
        if (out / name).exists():
            shutil.rmtree(out / name)


def gait_phase(frame: int, frames: int) -> float:
    """Return the phase of a frame in gait cycles. The capture covers a whole number of cycles, so it can be played in a
    loop."""
    return frame * max(1, round(frames / CYCLE_FRAMES)) / frames


def _make_cameras(figure: Figure, settings: SynthSettings) -> list[Camera]:
    """Create cameras that face the figure. They have the same focal length: the longest one at which the figure extends
    over at most the fraction FILL of each image."""
    unit = np.eye(3)
    poses = [pose_figure(figure, step / 48) for step in range(48)]
    target, up = np.array([0.0, 0.0, 0.88]), np.array([0.0, 0.0, 1.0])
    views, largest_span = [], 0.0
    for index in range(settings.cameras):
        angle = 2 * np.pi * index / settings.cameras
        position = np.array(
            [
                RING_RADIUS * np.cos(angle),
                RING_RADIUS * np.sin(angle),
                RING_HEIGHTS[index % len(RING_HEIGHTS)],
            ]
        )
        view = look_at(position, target, up, unit, settings.size, settings.size)
        extents = np.stack([projected_extent(parts, view) for parts in poses])
        low, high = extents[..., 0].min(0), extents[..., 1].max(0)
        largest_span = max(largest_span, float((high - low).max()))
        views.append((view, (low + high) / 2))
    focal = FILL * settings.size / largest_span
    cameras = []
    for view, middle in views:
        centre = settings.size / 2 - focal * middle
        intrinsics = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
        cameras.append(replace(view, intrinsics=intrinsics))
    return cameras


def _write_camera(
    out: Path, name: str, camera: Camera, figure: Figure, settings: SynthSettings, advance: Callable[[], None]
) -> None:
    """Write the clean plate (the image without the figure) and all frames of one camera."""
    plate = render_plate(camera, 2 * np.pi * figure.start)
    _write_image(out / "truth" / "bgs" / f"{name}.png", np.round(255 * plate).astype(np.uint8)[..., ::-1])
    for frame in range(settings.frames):
        parts = pose_figure(figure, gait_phase(frame, settings.frames))
        _write_frame(out, f"{name}/{frame:06d}", render_figure(parts, camera, plate, settings.gloss))
        advance()


def _write_frame(out: Path, stem: str, picture: RenderedFigure) -> None:
    _write_image(out / "images" / f"{stem}.jpg", picture.rgb[..., ::-1])
    _write_image(out / "masks" / f"{stem}.png", picture.mask)
    _write_image(out / "truth" / "depth" / f"{stem}.png", picture.depth)


def _write_image(path: Path, pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    options = [cv2.IMWRITE_JPEG_QUALITY, 95] if path.suffix == ".jpg" else []
    done, content = cv2.imencode(path.suffix, np.ascontiguousarray(pixels), options)
    if not done:
        raise RuntimeError(f"{path}: the image could not be encoded")
    write_bytes_atomically(path, content.tobytes())


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Terminal(stderr=True),
    )
