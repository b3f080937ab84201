"""Exports a scene as one file of the format 4dgs, which contains all frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.files import atomic_path
from fourd.base.progress import Track
from fourd.scene.rendering import Scene
from fourd.scene.scene import SceneManifest, to_triple
from fourd.scene.splats.cloud import SplatCloud, rotate_cloud
from fourd.scene.splats.dgs_writer import DgsSettings, DgsWriter, StartView
from fourd.scene.splats.frames import SplatFit


@dataclass(frozen=True)
class SceneClouds:
    """The splats of a scene, in the axes of the file.

    Attributes:
        scene: the scene.
        fit: converts points to splats.
        rotation: (3, 3) rotation from the scene's axes to those of the file, or None if they are the same.
        measure: is called with the scene, the index of a frame and all of its splats in the axes of the scene.
    """

    scene: Scene
    fit: SplatFit
    rotation: NDArray[np.float64] | None
    measure: Callable[[Scene, int, SplatCloud], None]

    def background(self) -> SplatCloud | None:
        """Return the splats of the static points, or None if the scene has none."""
        background = self.scene.background()
        return None if background is None else self.turn(self.fit.convert(background))

    def frame(self, index: int) -> SplatCloud:
        """Return the splats of the frame with the 0-based ``index``, without those of the static points."""
        self.measure(self.scene, index, self.fit.convert(self.scene.frame(index)))
        return self.turn(self.fit.convert(self.scene.dynamic_frame(index)))

    def turn(self, cloud: SplatCloud) -> SplatCloud:
        """Rotate splats to the axes of the file."""
        return cloud if self.rotation is None else rotate_cloud(cloud, self.rotation)


def write_dgs(
    out: Path, clouds: SceneClouds, frames: Sequence[int], degree: int, track: Track, *, has_up_y: bool
) -> None:
    """Write the frames with the indices ``frames``, one at a time. The file is written atomically.

    Args:
        out: the file.
        degree: degree of the spherical harmonics.
        track: reports progress.
        has_up_y: whether the up direction is +y.
    """
    manifest = clouds.scene.manifest
    view = _start_view(manifest, clouds.rotation)
    settings = DgsSettings(len(frames), manifest.fps, degree, manifest.metres_per_unit, view, has_up_y)
    with atomic_path(out) as temporary, temporary.open("w+b") as stream:
        writer = DgsWriter(stream, settings, out)
        background = clouds.background()
        if background is not None:
            writer.add_background(background)
        for position, index in enumerate(track(frames, len(frames), "export")):
            writer.add_frame(position, clouds.frame(index))
        writer.finish()


def _start_view(manifest: SceneManifest, rotation: NDArray[np.float64] | None) -> StartView | None:
    if not manifest.cameras:
        return None
    camera = manifest.cameras[0]
    turn = np.eye(3) if rotation is None else rotation
    fov_y = 2 * np.degrees(np.arctan2(camera.height / 2, camera.intrinsics[1, 1]))
    return StartView(float(fov_y), to_triple(turn @ camera.centre), to_triple(turn @ np.asarray(manifest.focus)))
