"""Writes random captures: a textured ball moves in a textured room, ray traced."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.recording.capture import write_calibration
from tests.random_captures.recipes import Recipe, Texture

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

ROOM_M = np.array([4.0, 4.0, 3.0])
"""Half the extents of the room along x, y and z."""
RADIUS_M = 3.0
"""Distance of the cameras from the axis of the room."""
TEXTURE_CELLS = 64
"""Cells along each axis of the random textures, which repeat."""
DISTORTION = np.array([-0.2, 0.05, 0.002, -0.001, 0.0])


def write_random(folder: Path, recipe: Recipe) -> Path:
    """Write the capture of a recipe into a new folder, or the videos if it has no calibration."""
    rng = np.random.default_rng([recipe.seed, 1])
    cameras = _make_cameras(recipe, rng)
    names = [f"{index:02d}" for index in range(recipe.cameras)]
    tables = {kind: rng.random((TEXTURE_CELLS,) * 3 + (3,)) for kind in ("wall", "subject")}
    views = [_render_camera(recipe, cameras, index, tables, rng) for index in range(recipe.cameras)]
    if not recipe.is_calibrated:
        for name, frames in zip(names, views, strict=True):
            _write_video(folder / f"{name}.mp4", [picture for picture, _ in frames])
        return folder
    for name, frames in zip(names, views, strict=True):
        for number, (picture, mask) in enumerate(frames):
            _write(folder / "images" / name / f"{number:06d}{recipe.suffix}", picture[..., ::-1])
            if recipe.masks != "none":
                shown = _shown_mask(recipe, name == names[-1], mask, rng)
                _write(folder / "masks" / name / f"{number:06d}.png", shown)
    write_calibration(folder, names, _given_calibration(recipe, cameras, rng))
    return folder


def _make_cameras(recipe: Recipe, rng: np.random.Generator) -> list[Camera]:
    width = recipe.size
    target, up = np.zeros(3), np.array([0.0, 0.0, 1.0])
    cameras = []
    for index in range(recipe.cameras):
        own_width = width // 2 if "other sizes" in recipe.faults and index == 1 else width
        own_height = max(2, round(own_width * recipe.aspect / 2) * 2)
        focal = own_width * rng.uniform(0.9, 1.1)
        intrinsics = np.array([[focal, 0, own_width / 2], [0, focal, own_height / 2], [0, 0, 1]])
        angle = np.radians(recipe.arc_deg * index / max(recipe.cameras - (recipe.arc_deg < 360), 1))
        centre = np.array([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), rng.uniform(-0.5, 1)])
        facing = 2 * centre - target if "camera that faces away" in recipe.faults and index == 0 else target
        camera = look_at(centre, facing, up, intrinsics, own_width, own_height)
        cameras.append(replace(camera, distortion=DISTORTION) if "distortion" in recipe.faults else camera)
    if "equal cameras" in recipe.faults:
        cameras[-1] = cameras[0]
    return cameras


def _given_calibration(recipe: Recipe, cameras: list[Camera], rng: np.random.Generator) -> list[Camera]:
    given = list(cameras)
    if "wrong calibration" in recipe.faults:
        given = [given[index] for index in rng.permutation(len(given))]
        given = [replace(pose, width=own.width, height=own.height) for pose, own in zip(given, cameras, strict=True)]
    if "equal calibrations" in recipe.faults:
        given[1] = replace(given[0], width=given[1].width, height=given[1].height)
    return given


def _render_camera(
    recipe: Recipe, cameras: list[Camera], index: int, tables: dict[str, Array], rng: np.random.Generator
) -> list[tuple[Picture, Picture]]:
    """Render the images (H, W, 3) and masks (H, W) of all frames of one camera."""
    frames = []
    for frame in range(recipe.frames):
        centre = np.array([0.4 * np.sin(frame), 0.3 * np.cos(2 * frame), 0.1 * frame])
        colours, mask = _trace(recipe, cameras[index], centre, tables)
        if "blur" in recipe.faults:
            colours = cv2.GaussianBlur(colours, (0, 0), 3.0)
        if "noise" in recipe.faults:
            colours = colours + rng.normal(0, 0.12, colours.shape)
        if "black camera" in recipe.faults and index == 0:
            colours = np.zeros_like(colours)
        if "black frame" in recipe.faults and frame == 0:
            colours = np.zeros_like(colours)
        if "constant images" in recipe.faults:
            colours = np.full_like(colours, 0.5)
        frames.append((np.round(255 * colours.clip(0, 1)).astype(np.uint8), mask))
    return frames


def _trace(recipe: Recipe, camera: Camera, centre: Array, tables: dict[str, Array]) -> tuple[Array, Picture]:
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    k = camera.intrinsics
    if camera.distortion is not None:
        pixels = cv2.undistortPoints(pixels, k, camera.distortion, R=None, P=k)
    rays = np.column_stack([pixels[:, 0], np.ones(len(pixels))]) @ np.linalg.inv(k).T @ camera.rotation
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    origin = camera.centre
    with np.errstate(divide="ignore"):
        to_wall = np.where(rays > 0, ROOM_M - origin, -ROOM_M - origin) / rays
    hit = origin + rays * to_wall.min(axis=1, keepdims=True)
    cells_per_m = recipe.size / (2 * RADIUS_M * recipe.cell_px)
    colours = _texture(recipe.wall, hit * cells_per_m, tables["wall"])
    to_ball = origin - centre
    half = rays @ to_ball
    root = half**2 - to_ball @ to_ball + recipe.radius_m**2
    is_ball = (root > 0) & (-half > 0)
    surface = origin + rays * (-half - np.sqrt(np.maximum(root, 0)))[:, None] - centre
    colours[is_ball] = _texture(recipe.subject, surface * 2 * cells_per_m, tables["subject"])[is_ball]
    shape = (camera.height, camera.width)
    return colours.reshape(*shape, 3), np.where(is_ball, 255, 0).astype(np.uint8).reshape(shape)


def _texture(kind: Texture, xyz: Array, table: Array) -> Array:
    """Colours (N, 3) in [0, 1] at the positions ``xyz`` (N, 3), in cells."""
    if kind == "plain":
        return np.tile(table[0, 0, 0], (len(xyz), 1))
    if kind == "repeated":
        return np.where(np.floor(xyz).astype(int).sum(axis=1, keepdims=True) % 2, table[0, 0, 0], table[1, 1, 1])
    cells = np.floor(xyz).astype(int) % TEXTURE_CELLS
    colours = table[cells[:, 0], cells[:, 1], cells[:, 2]]
    return 0.5 + 0.03 * (colours - 0.5) if kind == "weak" else colours


def _shown_mask(recipe: Recipe, is_last: bool, mask: Picture, rng: np.random.Generator) -> Picture:
    if recipe.masks == "all empty" or (recipe.masks == "empty in one view" and is_last):
        return np.zeros_like(mask)
    if recipe.masks == "all white":
        return np.full_like(mask, 255)
    return np.roll(mask, rng.integers(0, mask.shape[1], 2), (0, 1)) if recipe.masks == "wrong" else mask


def _write(path: Path, pixels: Picture) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels)


def _write_video(path: Path, pictures: list[Picture]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=Fraction(30))
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
