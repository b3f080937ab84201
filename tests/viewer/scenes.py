"""Scenes of opaque spherical shells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fourd.scene import BakedFrame, SceneWriter
from tests.baking.scenes import manifest, random_frame


def shell_frame(points: int, seed: int) -> BakedFrame:
    """A closed shell of overlapping points. The near side hides the far side, so only a few pixels show many layers of
    points."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(points, 3))
    frame = random_frame(points, 6, seed)
    return replace(
        frame,
        xyz=(0.5 * directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32),
        radius=np.full(points, 1.7 * (8 / points) ** 0.5 * 0.5, np.float16),
        density=rng.uniform(0.9, 1, points).astype(np.float16),
    )


def write_shells(path: Path, frames: int, points: int = 3000) -> None:
    """Write a scene with a different shell in every frame."""
    with SceneWriter(path, manifest(6, frames)) as writer:
        for index in range(frames):
            writer.add_frame(index, shell_frame(points, seed=index))
