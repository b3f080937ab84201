"""A synthetic capture of a ball that moves over a floor and casts a shadow. Clean plates show the empty floor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.formats.ply import write_ply
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.capture import write_calibration
from fourd.rendering.ops.points.arrays import render_points_numpy
from tests.captures import ring_cameras, sphere
from tests.training.small import full_config

SIZE, CAMERAS, FRAMES = 64, 8, 2
FLOOR = -0.45
Floats = NDArray[np.float32]


def ball_centre(frame: int) -> NDArray[np.float64]:
    return np.array([-0.35 + 0.7 * frame, 0.1, -0.15])


def floor() -> tuple[Floats, Floats]:
    """Points (N, 3) of the floor, and their unshadowed colours (N, 3) in [0, 1]."""
    steps = np.linspace(-1.2, 1.2, 40)
    x, y = (side.ravel() for side in np.meshgrid(steps, steps))
    # The colours vary slowly over the floor, because the model blends them from images that are only 64 pixels wide and
    # show the floor at a grazing angle.
    waves = np.stack([np.sin(4 * x), np.sin(3 * y), np.sin(2 * (x + y))], axis=1)
    xyz = np.stack([x, y, np.full_like(x, FLOOR)], axis=1)
    return xyz.astype(np.float32), (0.6 + 0.15 * waves).astype(np.float32)


def shadow_factor(xyz: Floats, frame: int) -> Floats:
    """Factors (N,) by which the shadow multiplies the colours of floor points: 0.4 below the ball, 1 far from it."""
    squared_distance = np.square(xyz[:, :2] - ball_centre(frame)[:2]).sum(axis=1)
    return (1 - 0.6 * np.exp(-squared_distance / 0.05)).astype(np.float32)


def picture(camera: Camera, frame: int | None, *, shadow: bool = True) -> tuple[Floats, Floats]:
    """Render RGB (H, W, 3) and the ball's matte (H, W). If ``frame`` is None, the image shows the empty floor."""
    xyz, rgb = floor()
    if frame is not None and shadow:
        rgb = rgb * shadow_factor(xyz, frame)[:, None]
    ball = (0.22 * sphere(3000) + ball_centre(frame or 0)).astype(np.float32)
    shade = np.repeat((0.5 + 0.4 * sphere(3000)[:, 2:]).astype(np.float32), 3, axis=1)
    parts = [(xyz, rgb, 0.07, 0.0)] + ([] if frame is None else [(ball, shade, 0.02, 1.0)])
    colours = [np.concatenate([colour, np.full((len(at), 1), of, np.float32)], 1) for at, colour, _, of in parts]
    image, alpha, _ = render_points_numpy(
        np.concatenate([part[0] for part in parts]),
        np.concatenate(colours),
        np.concatenate([np.full(len(part[0]), part[2], np.float32) for part in parts]),
        np.ones(sum(len(part[0]) for part in parts), np.float32),
        camera,
        layers=15,
        near=0.01,
    )
    return image[..., :3] + (1 - alpha)[..., None] * np.float32(0.35), image[..., 3]


def write_shadowed_capture(folder: Path) -> Path:
    """Write images, masks, plates and calibration into ``folder``."""
    cameras = ring_cameras(CAMERAS, SIZE)
    write_calibration(folder, [f"{index:02d}" for index in range(CAMERAS)], cameras)
    for index, camera in enumerate(cameras):
        _write(folder / "bgs" / f"{index:02d}.png", picture(camera, None)[0])
        for frame in range(FRAMES):
            rgb, matte = picture(camera, frame)
            _write(folder / "images" / f"{index:02d}" / f"{frame:06d}.png", rgb)
            _write(folder / "masks" / f"{index:02d}" / f"{frame:06d}.png", matte)
    return folder


def shadowed_config(seeds: Path, steps: int) -> TrainConfig:
    """The config of a full scene. The initial background points are the floor and a grey shell around the floor."""
    config = full_config(seeds)
    xyz, rgb = floor()
    shell = (5 * sphere(400)).astype(np.float32)
    grey = np.full((len(shell), 3), 89, np.uint8)
    write_ply(seeds, np.concatenate([xyz, shell]), np.concatenate([(rgb * 255).astype(np.uint8), grey]))
    background = replace(config.background, points=len(xyz) + len(shell), shadow=True)
    # The cameras are far apart. If the view weights decreased with the angle, almost all colours of the floor would
    # come from one image.
    model = replace(config.model, fade_views=False)
    return replace(config, model=model, background=background, points=600, max_steps=steps, checkpoint_steps=steps)


def _write(path: Path, image: Floats) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = (image.clip(0, 1) * 255 + 0.5).astype(np.uint8)
    assert cv2.imwrite(str(path), drawn[..., ::-1] if drawn.ndim == 3 else drawn)
