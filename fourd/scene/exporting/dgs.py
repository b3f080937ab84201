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
from fourd.scene.splats.cloud import SplatCloud, merge_clouds, rotate_cloud
from fourd.scene.splats.dgs_writer import DgsSettings, DgsWriter, StartView
from fourd.scene.splats.frames import SplatFit


@dataclass(frozen=True)
class DgsExport:
    """What the file contains.

    Attributes:
        frames: indices of the frames.
        fps: frames per second.
        degree: degree of the spherical harmonics.
        rotation: (3, 3) rotation from the scene's axes to those of the file, or None if they are the same.
        has_up_y: whether the up direction of the file is +y.
        measure: is called with the scene, the index of a frame, and all of its splats in the axes of the scene.
    """

    frames: Sequence[int]
    fps: float
    degree: int
    rotation: NDArray[np.float64] | None
    has_up_y: bool
    measure: Callable[[Scene, int, SplatCloud], None]


def write_dgs(out: Path, scene: Scene, fit: SplatFit, export: DgsExport, track: Track) -> None:
    """Write frames of a scene, one at a time. The file is written atomically. ``fit`` converts points to splats."""
    manifest = scene.manifest

    def turned(cloud: SplatCloud) -> SplatCloud:
        return cloud if export.rotation is None else rotate_cloud(cloud, export.rotation)

    view = _start_view(manifest, export.rotation)
    count = len(export.frames)
    settings = DgsSettings(count, export.fps, export.degree, manifest.metres_per_unit, view, export.has_up_y)
    with atomic_path(out) as temporary, temporary.open("w+b") as stream:
        writer = DgsWriter(stream, settings, out)
        points = scene.background()
        background = None if points is None else fit.convert(points)
        if background is not None:
            writer.add_background(turned(background))
        for position, index in enumerate(track(export.frames, count, "export")):
            cloud = fit.convert(scene.dynamic_frame(index))
            export.measure(scene, index, cloud if background is None else merge_clouds([cloud, background]))
            writer.add_frame(position, turned(cloud))
        writer.finish()


def _start_view(manifest: SceneManifest, rotation: NDArray[np.float64] | None) -> StartView | None:
    if not manifest.cameras:
        return None
    camera = manifest.cameras[0]
    turn = np.eye(3) if rotation is None else rotation
    fov_y = 2 * np.degrees(np.arctan2(camera.height / 2, camera.intrinsics[1, 1]))
    return StartView(float(fov_y), to_triple(turn @ camera.centre), to_triple(turn @ np.asarray(manifest.focus)))
