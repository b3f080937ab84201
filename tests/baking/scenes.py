"""Small random scenes for tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.scene import BakedFrame, SceneManifest, SceneReader, SceneWriter

NEAR_IN_BALL = 2.4
"""A near plane that, from the cameras of :func:`ring`, cuts the ball of :func:`random_frame`. Most points fade."""


def ring(count: int, size: int = 48, radius: float = 3.0, height: float = 0.5) -> tuple[Camera, ...]:
    """Return cameras in a ring around the z axis that point at the origin, with z up."""
    intrinsics = np.array([[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1]])
    angles = 2 * np.pi * np.arange(count) / count
    centres = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, height)], axis=1)
    up = np.array([0.0, 0, 1])
    return tuple(look_at(centre, np.zeros(3), up, intrinsics, size, size) for centre in centres)


def random_frame(points: int, views: int, seed: int) -> BakedFrame:
    """Return a ball of points with random colours."""
    rng = np.random.default_rng(seed)
    return BakedFrame(
        xyz=rng.normal(0, 0.3, (points, 3)).astype(np.float32),
        radius=rng.uniform(0.02, 0.05, points).astype(np.float16),
        density=rng.uniform(0.5, 1, points).astype(np.float16),
        sh=rng.normal(0, 0.5, (points, 3, 16)).astype(np.float16),
        blend_weights=rng.exponential(10, (points, views)).astype(np.float16),
        rgb=rng.integers(0, 256, (points, views, 3), dtype=np.uint8),
    )


def manifest(views: int = 6, frames: int = 3) -> SceneManifest:
    """Return the manifest of a scene with source views in a ring and one held-out camera."""
    cameras = ring(views + 1)
    return SceneManifest(
        source_names=tuple(f"{index:02d}" for index in range(views)),
        source_cameras=cameras[:views],
        focus=(0.0, 0.0, 0.0),
        bounds=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        frame_numbers=tuple(range(10, 10 + frames)),
        other_names=("held out",),
        other_cameras=cameras[views:],
        fps=24.0,
        fade_views=True,
        pixel_filter=0.1,
        producer="tests",
    )


def write_scene(path: Path, views: int = 6, frames: int = 3, points: int = 200) -> list[BakedFrame]:
    """Write a scene of random frames with different numbers of points. Returns the frames."""
    content = [random_frame(points + index, views, seed=index) for index in range(frames)]
    with SceneWriter(path, manifest(views, frames)) as writer:
        for index, frame in enumerate(content):
            writer.add_frame(index, frame)
    return content


def full_manifest(views: int = 6, frames: int = 3) -> SceneManifest:
    """Return the result of :func:`manifest`, changed to a scene with a background."""
    return replace(manifest(views, frames), kind="full")


def room_frame(points: int, views: int, seed: int, half: float = 20.0) -> BakedFrame:
    """Return the six opaque walls of a cube around the origin, each with a checkerboard of a different colour.

    Args:
        half: half of the cube's side in world units. The ball of :func:`random_frame` has a size of about 1.
    """
    rng = np.random.default_rng(seed)
    wall, along = rng.integers(0, 6, points), rng.uniform(-1, 1, (points, 3))
    along[np.arange(points), wall % 3] = np.where(wall < 3, -1.0, 1.0)
    across = np.stack([(wall % 3 + 1) % 3, (wall % 3 + 2) % 3], axis=1)
    squares = np.floor(4 * np.take_along_axis(along, across, axis=1)).astype(int).sum(axis=1) % 2
    colours = np.array([[200, 90, 80], [90, 200, 80], [80, 90, 200], [200, 200, 80], [80, 200, 200], [200, 80, 200]])
    rgb = (colours[wall] * np.where(squares, 1.0, 0.5)[:, None]).astype(np.uint8)
    return BakedFrame(
        xyz=(half * along).astype(np.float32),
        radius=np.full(points, 4.0 * half * (6 / max(points, 1)) ** 0.5, np.float16),
        density=np.ones(points, np.float16),
        sh=np.zeros((points, 3, 16), np.float16),
        blend_weights=rng.exponential(10, (points, views)).astype(np.float16),
        rgb=np.repeat(rgb[:, None], views, axis=1),
    )


def write_full_scene(
    path: Path, views: int = 6, frames: int = 3, points: int = 200, background_points: int = 300, shadow: bool = True
) -> tuple[list[BakedFrame], BakedFrame, list[NDArray[np.uint8]]]:
    """Write random frames inside a room. Returns the frames, the background and the shadows. If ``shadow`` is False,
    the list of shadows is empty."""
    dynamic = [random_frame(points + index, views, seed=index) for index in range(frames)]
    room = room_frame(background_points, views, seed=100)
    rng = np.random.default_rng(200)
    shadows = [rng.integers(0, 256, background_points, dtype=np.uint8) for _ in range(frames)] if shadow else []
    with SceneWriter(path, full_manifest(views, frames)) as writer:
        writer.add_background(room)
        for index, frame in enumerate(dynamic):
            writer.add_frame(index, frame, shadows[index] if shadow else None)
    return dynamic, room, shadows


def read_frames(path: Path, most: int) -> None:
    """Read at most ``most`` frames from the start of a scene file."""
    reader = SceneReader(path)
    try:
        for index in range(min(reader.manifest.frame_count, most)):
            reader.read(index)
    finally:
        reader.close()
