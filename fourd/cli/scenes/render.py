"""Render a run or a scene: capture views as PNG files, or a camera path as PNG files or an MP4."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from fourd.baking.playable import Playable, find_view, open_playable, select_frames
from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.viewer.navigation.paths import camera_path, fit_camera
from fourd.viewer.output.png import write_png
from fourd.viewer.output.video import write_video


@dataclass(frozen=True)
class Arguments:
    """Views write OUT/CAM/FRAME.png; a path writes OUT.mp4, or OUT/FRAME.png for a folder."""

    source: tyro.conf.Positional[Path]
    """A run's folder or a .4dv file."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """A folder, or a file that ends in .mp4."""
    views: str | None = None
    """Names of capture cameras to render from, with commas."""
    path: Literal["orbit", "spiral", "cameras"] | None = None
    """orbit: once around the scene; spiral: with height changing; cameras: through the capture's cameras."""
    frames: str | None = None
    """Frames as A:B or A:B:S, B not included; all when not given."""
    steps: int | None = None
    """Pictures along the path; the scene plays in a loop meanwhile. 120 when not given."""
    size: tuple[int, int] | None = None
    """Width and height in pixels; the capture's when not given."""
    layers: int | None = None
    """Points composited a pixel (K); what the source says when not given."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Red, green and blue behind the object, from 0 to 1."""
    fps: float | None = None
    """Frames a second of the video; the scene's when not given."""


def run(arguments: Arguments) -> None:
    """Open the source, make the cameras, render and write."""
    console = Console(stderr=True)
    if (arguments.views is None) == (arguments.path is None):
        raise UserError("--views, --path: expected one of them; name cameras (--views 05,11) or a path (--path orbit)")
    playable = open_playable(arguments.source)
    frames = select_frames(playable, arguments.frames)
    if arguments.views is not None:
        written = _write_views(arguments, playable, frames, console)
    else:
        written = _write_path(arguments, playable, frames, console)
    console.print(f"{arguments.out}: {written} pictures", soft_wrap=True)


def _write_views(arguments: Arguments, playable: Playable, frames: list[int], console: Console) -> int:
    assert arguments.views is not None
    names = [name.strip() for name in arguments.views.split(",") if name.strip()]
    cameras = [_sized(find_view(playable, name), arguments.size) for name in names]
    jobs = [(name, camera, frame) for frame in frames for name, camera in zip(names, cameras, strict=True)]
    if arguments.out.suffix == ".mp4":
        pictures = (_rgb(playable, camera, frame, arguments) for _, camera, frame in _shown(jobs, console))
        write_video(arguments.out, pictures, arguments.fps or playable.fps)
        return len(jobs)
    for name, camera, frame in _shown(jobs, console):
        number = playable.frame_numbers[frame]
        write_png(arguments.out / name / f"{number:06d}.png", _rgb(playable, camera, frame, arguments))
    return len(jobs)


def _write_path(arguments: Arguments, playable: Playable, frames: list[int], console: Console) -> int:
    assert arguments.path is not None
    steps = arguments.steps or max(120, len(frames))
    views = list(playable.views.values())
    cameras = camera_path(arguments.path, views, playable.focus, steps, size=arguments.size)
    jobs = [("", camera, frames[step % len(frames)]) for step, camera in enumerate(cameras)]
    pictures = (_rgb(playable, camera, frame, arguments) for _, camera, frame in _shown(jobs, console))
    if arguments.out.suffix == ".mp4":
        write_video(arguments.out, pictures, arguments.fps or playable.fps)
    else:
        for step, picture in enumerate(pictures):
            write_png(arguments.out / f"{step:06d}.png", picture)
    return len(jobs)


def _shown(jobs: list[tuple[str, Camera, int]], console: Console) -> Iterator[tuple[str, Camera, int]]:
    yield from track(jobs, description="render", console=console)


def _rgb(playable: Playable, camera: Camera, frame: int, arguments: Arguments) -> NDArray[np.uint8]:
    rgb = playable.render(camera, frame, arguments.layers, np.asarray(arguments.background, np.float32))
    return (rgb.clip(0, 1) * 255 + 0.5).astype(np.uint8)


def _sized(camera: Camera, size: tuple[int, int] | None) -> Camera:
    return camera if size is None else fit_camera(camera, *size)
