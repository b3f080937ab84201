"""Writing a synthetic capture: cameras, pictures, mattes, true depth and plates, and a marker of the settings."""

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
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from fourd.cameras import Camera, look_at
from fourd.capture.calibration import write_calibration
from fourd.errors import UserError
from fourd.files import write_bytes_atomically, write_text_atomically
from fourd.synth.figure import Figure, make_figure, pose
from fourd.synth.render import Picture, extent, render_figure, render_plate

Array = NDArray[np.float64]

MARKER = "synth.json"
VERSION = 1
CYCLE_FRAMES = 24
RING_RADIUS = 3.6
RING_HEIGHTS = (1.35, 0.75, 2.15)
FILLED = 0.9
"""Share of the picture's side that the whole movement spans."""


@dataclass(frozen=True)
class SynthSettings:
    """What decides every byte of a synthetic capture.

    Attributes:
        frames: at least 1. The gait is whole cycles of about 24 frames, so that the capture plays in a loop.
        cameras: from 3 to 100, evenly on a ring of 3.6 m at three heights.
        size: width and height of the pictures, from 32 to 4096 pixels.
        seed: at least 0; decides clothes, proportions and where the gait begins.
        gloss: strength of the highlights, from 0 to 1.

    Raises:
        UserError: naming the option that is out of its range.
    """

    frames: int = 24
    cameras: int = 12
    size: int = 256
    seed: int = 0
    gloss: float = 0.3

    def __post_init__(self) -> None:
        limits = {"frames": (1, 100_000), "cameras": (3, 100), "size": (32, 4096), "seed": (0, 2**63), "gloss": (0, 1)}
        for name, (least, most) in limits.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise UserError(f"--{name}: expected {least} to {most}, got {value}; give a number in that range")


def make_synthetic(
    out: Path | str, *, frames: int = 24, cameras: int = 12, size: int = 256, seed: int = 0, gloss: float = 0.3
) -> None:
    """Write a synthetic capture of a running figure into the folder ``out``.

    It holds images/CAM/FRAME.jpg, masks/CAM/FRAME.png (soft, 255 = figure), intri.yml,
    extri.yml, truth/depth/CAM/FRAME.png (uint16 millimetres along the viewing direction at
    pixel centres, 0 = none), truth/bgs/CAM.png (the empty studio) and synth.json (the settings).
    World in metres, z up. The same settings give the same bytes. A finished capture of these
    settings is left as it is; a synthetic one of other settings is replaced.

    Args:
        out: a folder that is missing, empty, or a synthetic capture.
        frames, cameras, size, seed, gloss: see :class:`SynthSettings`.

    Raises:
        UserError: when a number is out of its range or ``out`` holds something else.
    """
    out = Path(out)
    settings = SynthSettings(frames, cameras, size, seed, gloss)
    if is_finished(out, settings):
        return
    _prepare(out)
    _mark(out, settings, finished=False)
    figure = make_figure(seed)
    ring = _ring(figure, settings)
    names = [f"{index:02d}" for index in range(cameras)]
    write_calibration(out, names, ring)
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
    _mark(out, settings, finished=True)


def is_finished(out: Path | str, settings: SynthSettings) -> bool:
    """Whether ``out`` holds the whole capture of these settings already."""
    return _marker(Path(out)) == {"version": VERSION, **asdict(settings), "finished": True}


def _marker(out: Path) -> dict[str, object] | None:
    """Content of synth.json; None where there is none, or it is no such file."""
    try:
        content = json.loads((out / MARKER).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) and "version" in content else None


def _mark(out: Path, settings: SynthSettings, *, finished: bool) -> None:
    content = {"version": VERSION, **asdict(settings), "finished": finished}
    write_text_atomically(out / MARKER, json.dumps(content, indent=1) + "\n")


def _prepare(out: Path) -> None:
    """Make the folder; remove what an older synthetic capture left, since stale frames would mix with new ones."""
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: expected a folder, got a file; name another place")
    if out.is_dir() and any(out.iterdir()) and _marker(out) is None:
        raise UserError(
            f"{out}: expected an empty folder or a synthetic capture ({MARKER}), got other files; name another place"
        )
    out.mkdir(parents=True, exist_ok=True)
    for name in ("images", "masks", "truth"):
        if (out / name).exists():
            shutil.rmtree(out / name)


def _phase(frame: int, frames: int) -> float:
    """Turns of the gait: whole cycles over the capture, so that its end meets its beginning."""
    return frame * max(1, round(frames / CYCLE_FRAMES)) / frames


def _ring(figure: Figure, settings: SynthSettings) -> list[Camera]:
    """Cameras that look at the figure's middle; one focal length, the longest that never cuts the figure."""
    unit = np.eye(3)
    poses = [pose(figure, step / 48) for step in range(48)]
    target, up = np.array([0.0, 0.0, 0.88]), np.array([0.0, 0.0, 1.0])
    views, reach = [], 0.0
    for index in range(settings.cameras):
        angle = 2 * np.pi * index / settings.cameras
        place = np.array(
            [
                RING_RADIUS * np.cos(angle),
                RING_RADIUS * np.sin(angle),
                RING_HEIGHTS[index % len(RING_HEIGHTS)],
            ]
        )
        view = look_at(place, target, up, unit, settings.size, settings.size)
        spans = np.stack([extent(parts, view) for parts in poses])
        low, high = spans[..., 0].min(0), spans[..., 1].max(0)
        reach = max(reach, float((high - low).max()))
        views.append((view, (low + high) / 2))
    focal = FILLED * settings.size / reach
    cameras = []
    for view, middle in views:
        centre = settings.size / 2 - focal * middle
        intrinsics = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
        cameras.append(replace(view, intrinsics=intrinsics))
    return cameras


def _write_camera(
    out: Path, name: str, camera: Camera, figure: Figure, settings: SynthSettings, advance: Callable[[], None]
) -> None:
    """Every frame of one camera, and its plate."""
    plate = render_plate(camera, 2 * np.pi * figure.start)
    _write_image(out / "truth" / "bgs" / f"{name}.png", np.round(255 * plate).astype(np.uint8)[..., ::-1])
    for frame in range(settings.frames):
        parts = pose(figure, _phase(frame, settings.frames))
        _write_picture(out, f"{name}/{frame:06d}", render_figure(parts, camera, plate, settings.gloss))
        advance()


def _write_picture(out: Path, stem: str, picture: Picture) -> None:
    _write_image(out / "images" / f"{stem}.jpg", picture.rgb[..., ::-1])
    _write_image(out / "masks" / f"{stem}.png", picture.mask)
    _write_image(out / "truth" / "depth" / f"{stem}.png", picture.depth)


def _write_image(path: Path, pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    options = [cv2.IMWRITE_JPEG_QUALITY, 95] if path.suffix == ".jpg" else []
    done, content = cv2.imencode(path.suffix, np.ascontiguousarray(pixels), options)
    if not done:
        raise RuntimeError(f"{path}: the picture could not be encoded")
    write_bytes_atomically(path, content.tobytes())


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
