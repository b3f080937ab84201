"""Recipes of random captures: everything that distinguishes one capture from another, drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

Texture = Literal["noise", "weak", "repeated", "plain"]
Masks = Literal["true", "none", "empty in one view", "all empty", "all white", "wrong"]
Fault = Literal[
    "noise",
    "blur",
    "black camera",
    "black frame",
    "constant images",
    "equal calibrations",
    "equal cameras",
    "wrong calibration",
    "camera that faces away",
    "distortion",
    "other sizes",
]
Choice = TypeVar("Choice")

TEXTURES: tuple[Texture, ...] = ("noise", "noise", "weak", "repeated", "plain")
MASKS: tuple[Masks, ...] = (
    "true",
    "true",
    "true",
    "none",
    "none",
    "empty in one view",
    "all empty",
    "all white",
    "wrong",
)
FAULTS: tuple[Fault, ...] = (
    "noise",
    "blur",
    "black camera",
    "black frame",
    "constant images",
    "equal calibrations",
    "equal cameras",
    "wrong calibration",
    "camera that faces away",
    "distortion",
    "other sizes",
)
SIZES = (64, 64, 64, 64, 80, 96, 96, 128, 192, 256, 512)
MAX_CAMERA_PIXELS = 540_000
"""Maximum number of pixels of all images of a frame. Rigs with more pixels use the smallest size instead."""
MAX_FULL_PIXELS = 25_000
"""Maximum number of pixels of all images of a frame in recipes of full scenes. Their stereo depth maps are slow."""


@dataclass(frozen=True)
class Recipe:
    """A random capture.

    Attributes:
        seed: seed of the recipe and of all random numbers of the capture.
        cameras: number of cameras.
        frames: number of frames.
        size: width of the images in pixels.
        aspect: height of the images divided by their width.
        arc_deg: angle of the arc on which the cameras stand. 360 is a ring.
        wall, subject: textures of the room and of the moving ball.
        cell_px: approximate size of the textures' cells in the images.
        radius_m: radius of the ball.
        masks: what the masks show.
        faults: what else is unusual.
        suffix: suffix of the image files.
        is_calibrated: whether the recording has a calibration. A recording without one consists of videos.
        scene: argument --scene of fourd make.
    """

    seed: int
    cameras: int
    frames: int
    size: int
    aspect: float
    arc_deg: float
    wall: Texture
    subject: Texture
    cell_px: float
    radius_m: float
    masks: Masks
    faults: tuple[Fault, ...]
    suffix: Literal[".png", ".jpg"]
    is_calibrated: bool
    scene: Literal["object", "full"]


def draw_recipe(seed: int, *, max_cameras: int = 12, sizes: tuple[int, ...] = SIZES) -> Recipe:
    """Draw the recipe with this seed."""
    rng = np.random.default_rng(seed)
    cameras = int(rng.integers(2, max_cameras + 1))
    size = _one_of(rng, sizes)
    if cameras * size * size > MAX_CAMERA_PIXELS:
        size = sizes[0]
    is_calibrated = bool(rng.random() < 0.85)
    is_small = cameras * size * size <= MAX_FULL_PIXELS
    return Recipe(
        seed=seed,
        cameras=cameras,
        frames=_one_of(rng, (1, 2, 2, 3, 4) if is_calibrated else (2, 3)),
        size=size,
        aspect=_one_of(rng, (1.0, 0.75, 0.5625, 1.5)),
        arc_deg=_one_of(rng, (360.0, 180.0, 90.0, 30.0)),
        wall=_one_of(rng, TEXTURES),
        subject=_one_of(rng, TEXTURES),
        cell_px=float(rng.uniform(3, 12)),
        radius_m=_one_of(rng, (0.5, 0.5, 0.3, 0.03)),
        masks=_one_of(rng, MASKS),
        faults=tuple(fault for fault in FAULTS if rng.random() < 0.1),
        suffix=_one_of(rng, (".png", ".jpg")),
        is_calibrated=is_calibrated,
        scene="full" if is_small and rng.random() < 0.2 else "object",
    )


def _one_of(rng: np.random.Generator, choices: tuple[Choice, ...]) -> Choice:
    return choices[int(rng.integers(len(choices)))]
