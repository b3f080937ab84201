"""Path files as other programs write them, made without the code under test."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fourd.base.cameras import Camera, look_at
from fourd.viewer.camera_paths.scene import PathScene

SIZE = (96, 64)
FOV_DEG = 50.0
SCENE = PathScene((), np.zeros(3), 8, 24.0)


def cameras(count: int = 4) -> list[Camera]:
    """Cameras on an arc around the origin, which look at it."""
    focal = SIZE[1] / 2 / np.tan(np.radians(FOV_DEG) / 2)
    intrinsics = np.array([[focal, 0, SIZE[0] / 2], [0, focal, SIZE[1] / 2], [0, 0, 1]])
    angles = np.linspace(0, 2, count)
    return [look_at((3 * np.cos(a), 3 * np.sin(a), 0.7), (0, 0, 0), (0, 0, 1), intrinsics, *SIZE) for a in angles]


def camera_to_world(camera: Camera, rotation: np.ndarray | None = None, shift: np.ndarray | None = None) -> np.ndarray:
    """The matrix (4, 4) with the axes right, up and backwards in its columns, in a world that is turned and shifted."""
    right, down, forward = camera.rotation
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, -down, -forward, camera.centre])
    world = np.eye(4)
    world[:3, :3] = np.eye(3) if rotation is None else rotation
    world[:3, 3] = 0 if shift is None else shift
    return world @ matrix


def viewer_export(matrices: list[np.ndarray], times: list[float] | None = None) -> dict[str, Any]:
    """The JSON that the button "Generate Command" of nerfstudio's viewer (version 1.1) writes."""
    images: list[dict[str, Any]] = [
        {"camera_to_world": matrix.flatten().tolist(), "fov": FOV_DEG, "aspect": SIZE[0] / SIZE[1]}
        for matrix in matrices
    ]
    keys = [
        {
            "matrix": matrix.flatten().tolist(),
            "fov": FOV_DEG,
            "aspect": SIZE[0] / SIZE[1],
            "override_transition_enabled": False,
            "override_transition_sec": None,
        }
        for matrix in (matrices[0], matrices[-1])
    ]
    for image, time in zip(images, times or [], strict=False):
        image["render_time"] = time
    for key, time in zip(keys, times[:: len(times) - 1] if times else [], strict=False):
        key |= {"render_time": time, "override_time_enabled": True}
    return {
        "default_fov": FOV_DEG,
        **({} if times is None else {"default_time": 0.0}),
        "default_transition_sec": 2.0,
        "keyframes": keys,
        "camera_type": "perspective",
        "render_height": SIZE[1],
        "render_width": SIZE[0],
        "fps": 30.0,
        "seconds": 2.0,
        "is_cycle": False,
        "smoothness_value": 0.0,
        "camera_path": images,
    }


def write(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content))
    return path
