"""Generation of a synthetic capture: cameras, images, mattes, true depth, true clean plates (images without the figure)
and settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.base.errors import UserError
from fourd.recording.capture.calibration import write_calibration
from fourd.recording.capture.frame_rate import DEFAULT_FPS, check_rate, standard_rate, write_rate
from fourd.recording.synth.figure import Figure, make_figure, pose_figure
from fourd.recording.synth.folder import has_finished, prepare_folder, write_cameras, write_image, write_settings
from fourd.recording.synth.render import RenderedFigure, projected_extent, render_figure, render_plate

Array = NDArray[np.float64]

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
    prepare_folder(out)
    write_settings(out, asdict(settings), finished=False)
    figure = make_figure(seed)
    ring = ring_cameras(figure, settings)
    names = [f"{index:02d}" for index in range(cameras)]
    write_calibration(out, names, ring, metres_per_unit=1.0)
    write_rate(out, standard_rate(fps))
    write_cameras(
        names,
        frames,
        lambda index, advance: _write_camera(out, names[index], ring[index], figure, settings, advance),
    )
    write_settings(out, asdict(settings), finished=True)


def is_finished(out: Path | str, settings: SynthSettings) -> bool:
    """Return whether ``out`` contains a finished capture with these settings."""
    return has_finished(Path(out), asdict(settings))


def gait_phase(frame: float, frames: int) -> float:
    """Return the phase of a frame, or of a time between two frames, in gait cycles. The capture covers a whole number
    of cycles, so it can be played in a loop."""
    return frame * max(1, round(frames / CYCLE_FRAMES)) / frames


def ring_cameras(figure: Figure, settings: SynthSettings) -> list[Camera]:
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
    write_image(out / "truth" / "bgs" / f"{name}.png", np.round(255 * plate).astype(np.uint8)[..., ::-1])
    for frame in range(settings.frames):
        parts = pose_figure(figure, gait_phase(frame, settings.frames))
        _write_frame(out, f"{name}/{frame:06d}", render_figure(parts, camera, plate, settings.gloss))
        advance()


def _write_frame(out: Path, stem: str, picture: RenderedFigure) -> None:
    write_image(out / "images" / f"{stem}.jpg", picture.rgb[..., ::-1])
    write_image(out / "masks" / f"{stem}.png", picture.mask)
    write_image(out / "truth" / "depth" / f"{stem}.png", picture.depth)
