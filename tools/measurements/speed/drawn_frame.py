"""The frame and the camera with which programs in this folder measure the drawing of points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from fourd.base.cameras import Camera
from fourd.benchmarks.workloads import make_baked_frame, make_camera
from fourd.scene import BakedFrame, SceneManifest, open_scene
from fourd.viewer.navigation.paths import fit_camera


@dataclass(frozen=True)
class DrawnFrame:
    """A frame of a scene, or the synthetic benchmark scene, and the size of its images."""

    scene: tyro.conf.Positional[Path | None] = None
    """A .4dv file. The default is the synthetic benchmark scene."""
    frame: int = 0
    """Index of the frame in the scene, from 0."""
    points: int = 262_144
    """Number of points of the synthetic benchmark scene."""
    size: tuple[int, int] = (1920, 1080)
    """Width and height of the images in pixels."""

    def open(self, *, is_ordered: bool) -> tuple[BakedFrame, SceneManifest, Camera]:
        """Return the frame, its manifest and a camera. ``is_ordered`` gives the points of the benchmark scene in Morton
        order, as exported scenes have them."""
        if self.scene is None:
            frame, manifest = make_baked_frame(self.points, ordered=is_ordered)
            return frame, manifest, make_camera(*self.size, angle=0.3)
        with open_scene(self.scene) as scene:
            camera = fit_camera(scene.manifest.cameras[0], *self.size)
            return scene.frame(self.frame), scene.manifest, camera
